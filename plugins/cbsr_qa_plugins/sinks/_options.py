"""Options that sinks share: paths and topics with fields, and secrets from environment variables."""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from string import Formatter
from typing import Annotated, Any, Final

from pydantic import AfterValidator, Field

from cbsr_qa.plugin import ConfigError
from cbsr_qa.system.foreign import check_regular

#: Fields of every template.
_FIELDS: Final = ("station", "serial", "run")

#: The longest wait for an answer [s].
Timeout = Annotated[float, Field(ge=0.1, le=60)]


def check_template(text: str, *more: str) -> str:
    """Return a template that has no other fields than allowed. ValueError if it has, or if it is malformed.

    Parameters
    ----------
    more : fields allowed besides ``station``, ``serial`` and ``run``.
    """
    allowed = (*_FIELDS, *more)
    try:
        parts = list(Formatter().parse(text))
    except ValueError as error:
        raise ValueError(f"{error}; {_describe_fields(allowed)}") from None
    for _, name, rule, conversion in parts:
        if name is not None and (name not in allowed or rule or conversion):
            raise ValueError(_describe_fields(allowed))
    if not text.isprintable() or not text:
        raise ValueError("it must have at least one character, and no control characters")
    return text


def _describe_fields(fields: tuple[str, ...]) -> str:
    return f"it may have the fields {', '.join(f'{{{name}}}' for name in fields)}; a brace is written twice"


def fill_template(template: str, message: Mapping[str, Any]) -> str:
    """Return a template with the fields of a message; a name cannot add a level to a path or a topic."""
    kind = message.get("event", message)["type"]
    values = {name: message.get(name, "") or "_" for name in _FIELDS} | {"type": kind}
    return template.format(**{name: re.sub(r"^\.|[^\w.-]", "_", value) for name, value in values.items()})


def _environment_variable(name: str) -> str:
    if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]{0,127}", name):
        return name
    raise ValueError("it must be the name of an environment variable, not the secret itself")


#: Name of an environment variable that holds a secret.
EnvironmentVariable = Annotated[str, AfterValidator(_environment_variable)]


def secret(option: str, variable: str | None) -> str | None:
    """Return the secret in an environment variable, None without one.

    Raises
    ------
    ConfigError
        If the variable is not set, or its value cannot be sent in a header.
    """
    if variable is None:
        return None
    value = os.environ.get(variable, "")
    if not value:
        raise ConfigError(f"{option}: the environment variable {variable} is not set", remedy="set it, or remove it")
    if not (value.isascii() and value.isprintable()):
        raise ConfigError(
            f"{option}: the value of {variable} has other characters than printable ASCII", remedy="correct it"
        )
    return value


def check_ca_file(path: str | None) -> None:
    """ConfigError if the file of ``ca_file`` does not exist, or is a folder, pipe or device."""
    try:
        if path is not None:
            check_regular(Path(path))
    except OSError as error:
        raise ConfigError(
            f"ca_file names {path!r}, which cannot be read: {error.strerror}", remedy="correct the path"
        ) from error
