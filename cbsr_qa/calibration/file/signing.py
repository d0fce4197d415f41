"""Signatures of calibrations: what is signed, how a file states it, and what is checked.

A signature covers the UTF-8 bytes of four lines, each ended by NEWLINE: ``cbsr-qa calibration signature``, the
``digest`` of the content, the time of signing and the public key. The digest covers every value that is read from a
file with its path, unit, kind and shape, and is the same in HDF5 and JSON. So a signature does not cover bytes that
no reader uses, and stays valid in a file that is written again.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, TypeVar

from cbsr_qa.calibration.file.content import content_digest
from cbsr_qa.calibration.file.entries import Issued, encode
from cbsr_qa.calibration.file.keys import SigningKey, library, public_key
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.results.signature import Signature, fingerprint

_Kind = TypeVar("_Kind", bound=Issued)

#: Form of each part of a signature in a file.
SIGNATURE: Final[Mapping[str, re.Pattern[str]]] = {
    "public_key": re.compile("[0-9a-f]{64}"),
    "signed_at": re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", re.ASCII),
    "signature": re.compile("[0-9a-f]{128}"),
}
_AS_ISSUED: Final = "use the file as it was issued: copy it again from where it was signed"


def with_signature(calibration: _Kind, key: SigningKey, at: datetime) -> _Kind:
    """Return an issued calibration with a signature; the bytes of its file are still those without it.

    Parameters
    ----------
    at : time of signing, stated to the second.
    """
    signed_at = at.astimezone(UTC).isoformat(timespec="seconds")
    digest = content_digest(encode(calibration))
    statement = _statement(digest, signed_at, key.public_key)
    signature = Signature(key.public_key, signed_at, key.sign(statement))
    return replace(calibration, digest=digest, signature=signature)


def read_signature(stated: Mapping[str, Any]) -> Signature | None:
    """Return the signature that a file states; None if it states no part of one.

    CalibrationError if a part is missing or malformed.
    """
    missing_parts = [name for name in SIGNATURE if name not in stated]
    if len(missing_parts) == len(SIGNATURE):
        return None
    if missing_parts:
        present_parts = " and ".join(name for name in SIGNATURE if name in stated)
        raise CalibrationError(
            f"its signature was removed in part: {' and '.join(missing_parts)} is missing beside {present_parts}",
            remedy=_AS_ISSUED,
        )
    for name, form in SIGNATURE.items():
        if not (isinstance(stated[name], str) and form.fullmatch(stated[name])):
            raise CalibrationError(f"its signature is damaged: {name} is not one", remedy=_AS_ISSUED)
    return Signature(**{name: stated[name] for name in SIGNATURE})


def check_signature(calibration: Issued, pinned: str = "") -> None:
    """Check the signature of a calibration over its content as it is in memory.

    Parameters
    ----------
    pinned : public key, in hexadecimal digits, whose signature is required; empty for any.

    Raises
    ------
    CalibrationError
        If it is not signed, was changed since, or was signed by another key.
    """
    signature = calibration.signature
    if signature is None:
        signer = f"the pinned key {fingerprint(pinned)}" if pinned else "a key"
        raise CalibrationError(
            f"not signed, and a signature by {signer} is required: it was removed, or there never was one",
            remedy="use a file signed by that key; `cbsr-qa calibration sign` signs one that you trust",
        )
    statement = _statement(content_digest(encode(calibration)), signature.signed_at, signature.public_key)
    if not is_signature(signature, statement):
        raise CalibrationError(
            f"its signature by {signature.words} does not fit: content, time, key or signature was changed since, or"
            " the signature is that of another file",
            remedy=_AS_ISSUED,
        )
    if pinned and signature.public_key != pinned:
        raise CalibrationError(
            f"signed by {signature.words}, not by the pinned key {fingerprint(pinned)}",
            remedy="use a file signed by the pinned key; or pin the key of who signed this one, if you trust it",
        )


def check_signed_file(path: str | Path, calibration: Issued, key: str | Path | None) -> None:
    """Check the signature of a calibration that was read from a file.

    Parameters
    ----------
    key : PEM file with the public key that must have signed it, which is pinned; None for any key.

    Raises
    ------
    CalibrationError
        Naming the file, as :func:`check_signature`.
    RefusedError
        If the key cannot be used, or ``cryptography`` is not installed.
    """
    pinned = "" if key is None else public_key(Path(key))
    try:
        check_signature(calibration, pinned)
    except CalibrationError as error:
        raise CalibrationError(f"calibration file {path}: {error.reason}", remedy=error.remedy) from error


def is_signature(signature: Signature, statement: bytes) -> bool:
    """Whether a signature is that of a statement. RefusedError if ``cryptography`` is not installed."""
    ed25519, invalid = library("hazmat.primitives.asymmetric.ed25519"), library("exceptions").InvalidSignature
    try:
        key = ed25519.Ed25519PublicKey.from_public_bytes(bytes.fromhex(signature.public_key))
        key.verify(bytes.fromhex(signature.signature), statement)
    except (invalid, ValueError):
        return False
    return True


def _statement(digest: str, signed_at: str, public_key: str) -> bytes:
    return f"cbsr-qa calibration signature\n{digest}\n{signed_at}\n{public_key}\n".encode()
