"""Signature of a calibration, as its file states it."""

import hashlib
from dataclasses import dataclass
from textwrap import wrap
from typing import Final

_FINGERPRINT_DIGITS: Final = 32


@dataclass(frozen=True, slots=True)
class Signature:
    """Ed25519 signature (RFC 8032) of a calibration's content and of the time of signing.

    Parameters
    ----------
    public_key : public key of the signer, 32 bytes in hexadecimal digits.
    signed_at : ISO time in UTC, as the signer stated it.
    signature : 64 bytes in hexadecimal digits.
    """

    public_key: str
    signed_at: str
    signature: str

    @property
    def words(self) -> str:
        """Whose signature it says it is, and of when."""
        return f"key {fingerprint(self.public_key)} at {self.signed_at}"


def fingerprint(public_key: str) -> str:
    """Return the first 128 bits of the SHA-256 of a public key, in groups of four hexadecimal digits."""
    digest = hashlib.sha256(bytes.fromhex(public_key)).hexdigest()
    return "-".join(wrap(digest[:_FINGERPRINT_DIGITS], 4))
