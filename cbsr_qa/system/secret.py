"""Secrets in environment variables, or in the files that these name."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.system.foreign import read_foreign

_MAX_SECRET_BYTES: Final = 2**16


def secret_of(variable: str, *, remedy: str, environment: Mapping[str, str] = os.environ) -> str | None:
    """Return the secret in a variable, or with ``@FILE`` in a file, without blanks around it; None if it is not set.

    ConfigError if the file cannot be read. The message does not quote the variable.
    """
    value = environment.get(variable)
    if value is not None and value.startswith("@"):
        try:
            value = read_foreign(Path(value[1:]), _MAX_SECRET_BYTES).decode()
        except (OSError, ValueError) as error:
            reason = (error.strerror if isinstance(error, OSError) else None) or "not UTF-8 text"
            raise ConfigError(f"the file that {variable} names cannot be read: {reason}", remedy=remedy) from None
    return None if value is None else value.strip()
