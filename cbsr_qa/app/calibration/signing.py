"""Checking, signing and the keys of calibration files."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from cbsr_qa.app.calibration.file import is_json, read_any, write_json
from cbsr_qa.calibration.file.entries import Issued
from cbsr_qa.calibration.file.hdf5 import read_in_child, sign_calibration, verify_calibration_file, write_calibration
from cbsr_qa.calibration.file.json import verify_json_calibration
from cbsr_qa.calibration.file.keys import new_key, passphrase, public_path, signing_key
from cbsr_qa.calibration.file.signing import check_signed_file
from cbsr_qa.domain.errors import CalibrationError, RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.results.signature import fingerprint
from cbsr_qa.report.page import answer
from cbsr_qa.system.clock import RealClock

_UNCHECKED: Final = "the file states no SHA-256 of its bytes, so they were not checked before HDF5 parsed them"
_NOT_PINNED: Final = (
    "no key was pinned, so anybody may have made it: --public-key FILE requires the key that you trust"
)


@dataclass(frozen=True, slots=True)
class CheckedSignature:
    """A file's signature.

    Parameters
    ----------
    key : fingerprint of the signer's public key.
    signed_at : time that the signer stated.
    checked : whether the signature fits the content; False only where ``cryptography`` is not installed and no key
        was pinned.
    pinned : whether the signature had to be by a given key, and is.
    """

    key: str
    signed_at: str
    checked: bool
    pinned: bool

    @property
    def words(self) -> str:
        which = f"by {'the pinned ' if self.pinned else ''}key {self.key}"
        return f"valid, {which}" if self.checked else f"not checked, {which}"


@dataclass(frozen=True, slots=True)
class SoundFile:
    """A complete, unaltered file of a known version.

    Parameters
    ----------
    digest, record_digest : SHA-256 of the file's content, and of the part kept in the database.
    bytes_checked : whether the file states the SHA-256 of its bytes, which is then checked before HDF5 parses them.
        JSON states none.
    signature : None if the file is not signed.
    """

    file: Path
    sound: bool
    digest: str
    record_digest: str
    schema_version: int
    datasets: int
    bytes_checked: bool
    signature: CheckedSignature | None


def verify_file(path: Path, key: Path | None = None) -> CommandOutcome[SoundFile]:
    """Check digest, schema and signature of a calibration file, HDF5 or JSON.

    Parameters
    ----------
    key : file with the public key that must have signed it; None for any signature, or none.

    Raises
    ------
    CalibrationError
        If the file is damaged, or not signed as required; the message says how.
    RefusedError
        If the key cannot be used.
    """
    verify = verify_json_calibration if is_json(path) else verify_calibration_file
    checked = read_in_child(path, partial(verify, path))
    issued = read_any(path)
    signature, warnings = _check_signature(path, issued, key)
    verified = fill_from_object(SoundFile, checked, file=path, sound=True, digest=issued.digest, signature=signature)
    facts = [("SHA-256", verified.digest), ("Signature", "none" if signature is None else signature.words)]
    if signature is not None:
        facts.append(("Signed at", signature.signed_at))
    if not (checked.bytes_checked or is_json(path)):
        warnings.append(_UNCHECKED)
    content = f"{verified.datasets} datasets, schema {verified.schema_version}"
    return answer(verified, f"{path} is sound", content, facts, warnings=warnings)


def _check_signature(path: Path, issued: Issued, key: Path | None) -> tuple[CheckedSignature | None, list[str]]:
    """Return a file's signature, and what a reader must know of it."""
    if issued.signature is None and key is None:
        return None, []
    warnings, checked = [] if key else [_NOT_PINNED], True
    try:
        check_signed_file(path, issued, key)
    except CalibrationError:
        raise
    except RefusedError as error:  # the library is missing
        if key is not None:
            raise
        warnings, checked = [f"its signature was not checked: {error.reason}; {error.remedy}"], False
    assert issued.signature is not None
    who, when = fingerprint(issued.signature.public_key), issued.signature.signed_at
    return CheckedSignature(who, when, checked, key is not None), warnings


@dataclass(frozen=True, slots=True)
class SignedFile:
    """A calibration file that was signed.

    Parameters
    ----------
    key : fingerprint of the signer's public key.
    replaced : fingerprint of the key whose signature it had before; None without.
    """

    file: Path
    digest: str
    key: str
    signed_at: str
    replaced: str | None


def sign_file(path: Path, key: Path, *, again: bool = False) -> CommandOutcome[SignedFile]:
    """Sign a calibration file, HDF5 or JSON, in its place: its content stays.

    Parameters
    ----------
    key : file with the private key.
    again : whether to replace a signature that the file has.

    Raises
    ------
    CalibrationError
        If the file is damaged, cannot be written, or is signed and ``again`` is not given.
    RefusedError
        If the key cannot be used.
    """
    private = signing_key(key)
    issued = read_any(path)
    earlier_signature = issued.signature
    if earlier_signature is not None and not again:
        raise CalibrationError(
            f"calibration file {path}: signed already, by {earlier_signature.words}",
            remedy="--again replaces that signature",
        )
    signed, file = sign_calibration(issued, private, RealClock().wall()), path.resolve()
    if is_json(path):
        write_json(file, signed)
    else:
        write_calibration(file, signed)
    assert signed.signature is not None
    replaced = None if earlier_signature is None else fingerprint(earlier_signature.public_key)
    signer, signed_at = fingerprint(signed.signature.public_key), signed.signature.signed_at
    facts = [("SHA-256", f"{signed.digest}, as before"), ("Signed at", signed_at)]
    if replaced is not None:
        facts.append(("Replaced", f"the signature by key {replaced}"))
    return answer(
        SignedFile(path, signed.digest, signer, signed_at, replaced),
        f"{path} is signed",
        f"by key {signer}",
        facts,
        warnings=private.warnings,
    )


@dataclass(frozen=True, slots=True)
class NewKey:
    """A key pair that was made.

    Parameters
    ----------
    encrypted : whether the private key needs a passphrase.
    """

    private_key: Path
    public_key: Path
    fingerprint: str
    encrypted: bool


def make_key(path: Path) -> CommandOutcome[NewKey]:
    """Make a key pair that signs calibrations: the private key, and FILE.pub next to it.

    Raises
    ------
    RefusedError
        If a file exists or cannot be written, the passphrase cannot be used, or ``cryptography`` is not installed.
    """
    encrypted = passphrase() is not None
    new = NewKey(path, public_path(path), fingerprint(new_key(path)), encrypted)
    lock = "encrypted with the passphrase" if encrypted else "not encrypted: anyone who reads it can sign"
    printed = (("Private key", f"{path} ({lock})"), ("Public key", f"{new.public_key} (give it to those who check)"))
    return answer(new, "key made", new.fingerprint, printed=printed)
