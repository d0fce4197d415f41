"""The optional key that signs the links of runs: it never reaches a log, a message, a document or the database."""

import hmac
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Self

from cbsr_qa.domain.errors import ConfigError

VARIABLE: Final = "CBSR_QA_SIGNING_KEY"
_LEAST: Final = 16
_REMEDY: Final = f"set {VARIABLE} to a key of at least {_LEAST} characters, or to @FILE, or unset it"


class SigningKey:
    """A key for HMAC-SHA256. ``key_id`` (12 hexadecimal digits) names it without telling anything of it."""

    def __init__(self, secret: bytes) -> None:
        self._secret = secret
        self.key_id = self._mac("cbsr-qa signing key")[:12]

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ) -> Self | None:
        """Return the key that is set; None where none is.

        Raises
        ------
        ConfigError
            If it is empty or short, or its file cannot be read. The message repeats nothing of the setting.
        """
        said = environment.get(VARIABLE)
        if said is None:
            return None
        if said.startswith("@"):
            try:
                said = Path(said[1:]).read_text(encoding="utf-8")
            except (OSError, ValueError) as error:
                why = (error.strerror if isinstance(error, OSError) else None) or "not UTF-8 text"
                raise ConfigError(f"the file that {VARIABLE} names cannot be read: {why}", remedy=_REMEDY) from None
        secret = said.strip()
        if len(secret) < _LEAST:
            raise ConfigError(f"the signing key in {VARIABLE} has {len(secret)} characters", remedy=_REMEDY)
        return cls(secret.encode("utf-8", "surrogateescape"))

    def __repr__(self) -> str:
        return f"SigningKey({self.key_id})"

    def sign(self, run: str, link: str) -> str:
        """Return the signature of a link of a run, hexadecimal."""
        return self._mac(f"cbsr-qa link\n{run}\n{link}")

    def signed(self, run: str, link: str, mac: str) -> bool:
        """Whether a signature is this key's."""
        return hmac.compare_digest(self.sign(run, link), mac)

    def _mac(self, text: str) -> str:
        return hmac.digest(self._secret, text.encode(), "sha256").hex()
