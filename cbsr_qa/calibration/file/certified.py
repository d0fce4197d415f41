"""Signature files of certificates, and lists of withdrawn ones; both JSON, signed with the key of calibrations.

A signature covers UTF-8 text: a first line that says what it is of, then the JSON of everything in the file but
``signature``, with sorted keys and without blanks. It is detached: the certificate's page and XML stand beside it,
each named by the SHA-256 of its bytes.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any, Final, TypeVar

from cbsr_qa.calibration.file.entries import Issued
from cbsr_qa.calibration.file.keys import SigningKey, public_key
from cbsr_qa.calibration.file.signing import check_signed_file, is_signature, read_signature
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.filling import fill_from_mapping, find_odd_value
from cbsr_qa.domain.results.signature import fingerprint
from cbsr_qa.system.foreign import read_foreign
from cbsr_qa.system.json_text import parse_json

_MOST_BYTES: Final = 2**26
_CERTIFICATE: Final = "cbsr-qa certificate"
_WITHDRAWN: Final = "cbsr-qa withdrawn certificates"
#: What each format is, and which file has it.
_MEANT: Final = {
    _CERTIFICATE: ("the signature file of a certificate", "name NUMBER.signature.json, which is beside page and XML"),
    _WITHDRAWN: ("a list of withdrawn certificates", "name the file that `cbsr-qa certificate withdrawn` wrote"),
}
_AGAIN: Final = "copy it again from where it was issued"

_Kind = TypeVar("_Kind", "CertificateSeal", "WithdrawnList")


@dataclass(frozen=True, slots=True)
class CertificateSeal:
    """What the signature file of a certificate states.

    Parameters
    ----------
    number, serial : of the certificate and of its sensor.
    calibration_digest : SHA-256 of the content of the certified calibration.
    valid_until : ISO date; None: no validity is stated.
    html_sha256, dcc_sha256 : of the bytes of page and XML.
    public_key, signed_at, signature : as in a calibration; empty signature: not signed yet.
    """

    number: str
    serial: str
    calibration_digest: str
    valid_until: str | None
    html_sha256: str
    dcc_sha256: str
    public_key: str = ""
    signed_at: str = ""
    signature: str = ""
    format: str = _CERTIFICATE


@dataclass(frozen=True, slots=True)
class Withdrawn:
    """A certificate that no longer holds.

    Parameters
    ----------
    calibration_digest : of its calibration; empty where another certificate of that calibration holds.
    words : what became of it, when, by whom and why.
    """

    number: str
    calibration_digest: str
    words: str


@dataclass(frozen=True, slots=True)
class WithdrawnList:
    """Certificates that a laboratory replaced or revoked, as of ``signed_at``."""

    withdrawn: tuple[Withdrawn, ...]
    public_key: str = ""
    signed_at: str = ""
    signature: str = ""
    format: str = _WITHDRAWN

    def find(self, number: str, calibration_digest: str) -> Withdrawn | None:
        """Return the entry of a certificate, or of a calibration if ``number`` is empty; None without one."""
        if number:
            return next((one for one in self.withdrawn if one.number == number), None)
        return next((one for one in self.withdrawn if one.calibration_digest == calibration_digest), None)


def sign(content: _Kind, key: SigningKey, at: datetime) -> _Kind:
    """Return a content with its signature; the time of signing is stated to the second."""
    unsigned = replace(
        content, public_key=key.public_key, signed_at=at.astimezone(UTC).isoformat(timespec="seconds"), signature=""
    )
    return replace(unsigned, signature=key.sign(_statement(unsigned)))


def to_text(content: CertificateSeal | WithdrawnList) -> str:
    """Return the text of a file."""
    return json.dumps(asdict(content), indent=1, ensure_ascii=False) + "\n"


def read_seal(path: Path) -> CertificateSeal:
    """Read the signature file of a certificate. CalibrationError if the file is another one, or damaged."""
    return _read(path, CertificateSeal)


def read_withdrawn(path: Path) -> WithdrawnList:
    """Read a list of withdrawn certificates. CalibrationError if the file is another one, or damaged."""
    return _read(path, WithdrawnList)


def check_sealed(path: Path, content: CertificateSeal | WithdrawnList, key: str | Path | None) -> None:
    """Check the signature of a file.

    Parameters
    ----------
    key : PEM file with the public key that must have signed it; None for any key.

    Raises
    ------
    CalibrationError
        If it is not signed, was changed since, or was signed by another key.
    RefusedError
        If the key cannot be used, or ``cryptography`` is not installed.
    """
    pinned = "" if key is None else public_key(Path(key))
    stated = {name: getattr(content, name) for name in ("public_key", "signed_at", "signature")}
    signature = read_signature(stated if content.signature else {})
    if signature is None:
        raise CalibrationError(f"{path} is not signed", remedy=_AGAIN)
    if not is_signature(signature, _statement(replace(content, signature=""))):
        raise CalibrationError(
            f"{path}: its signature by {signature.words} does not fit: it was changed", remedy=_AGAIN
        )
    if pinned and signature.public_key != pinned:
        raise CalibrationError(f"{path}: signed by {signature.words}, not by the pinned key {fingerprint(pinned)}")


def find_clock_problem(signed_at: str, today: date) -> str:
    """Return what is odd about a day that is before a signature was made; empty if it is not."""
    day = datetime.fromisoformat(signed_at).date()
    if day <= today:
        return ""
    return f"was signed on {day}, and by the clock of this computer it is {today}: one of them is wrong"


def check_use(
    path: Path,
    issued: Issued,
    public_key: str | Path | None,
    certificate: str | Path | None = None,
    withdrawn: str | Path | None = None,
    today: date | None = None,
) -> None:
    """Check that a calibration may be used: signed, or certified by a signed certificate, and not withdrawn.

    Parameters
    ----------
    public_key : PEM file with the key that must have signed it; with a certificate, the key that must have signed
        that one, which names the calibration by its SHA-256. None: signatures of calibrations are not looked at.
    certificate, withdrawn : as :func:`check_certified`; None: not checked.
    today : day on which the certificate must be valid; None for the computer's (UTC).

    Raises
    ------
    CalibrationError, RefusedError
        As :func:`check_certified`.
    """
    if public_key is not None and certificate is None:
        check_signed_file(path, issued, public_key)
    if certificate is not None or withdrawn is not None:
        day = datetime.now(UTC).date() if today is None else today
        check_certified(issued.digest, certificate, withdrawn, public_key=public_key, today=day)


def check_certified(
    digest: str,
    certificate: str | Path | None,
    withdrawn: str | Path | None,
    *,
    public_key: str | Path | None,
    today: date,
) -> None:
    """Check that a calibration is certified, that its certificate has not lapsed, and that no list withdraws it.

    Parameters
    ----------
    digest : SHA-256 of the content of the calibration.
    certificate : signature file of its certificate; None: only the list is looked at.
    withdrawn : list of withdrawn certificates; None: none is looked at.
    public_key : PEM file with the key that must have signed both; None for any key.

    Raises
    ------
    CalibrationError
        If a file is damaged, not signed as required or signed after ``today``, the certificate is of another
        calibration, has lapsed, or was withdrawn.
    RefusedError
        If the key cannot be used.
    """
    seal = None
    if certificate is not None:
        seal = read_seal(Path(certificate))
        check_sealed(Path(certificate), seal, public_key)
        _check_clock(f"certificate {seal.number}", seal.signed_at, today)
        if seal.calibration_digest != digest:
            raise CalibrationError(
                f"certificate {seal.number} is of another calibration, with SHA-256 {seal.calibration_digest}",
                remedy="name the signature file of the certificate of this calibration",
            )
        if seal.valid_until is not None and date.fromisoformat(seal.valid_until) < today:
            raise CalibrationError(
                f"certificate {seal.number} lapsed: it was valid until {seal.valid_until}",
                remedy="calibrate the sensor again",
            )
    if withdrawn is not None:
        listed = read_withdrawn(Path(withdrawn))
        check_list(Path(withdrawn), listed, seal, public_key, today)
        entry = listed.find("" if seal is None else seal.number, digest)
        if entry is not None:
            raise CalibrationError(
                f"certificate {entry.number} of this calibration was {entry.words}",
                remedy="ask the laboratory for the certificate that replaces it, or calibrate the sensor again",
            )


def check_list(
    path: Path, listed: WithdrawnList, seal: CertificateSeal | None, key: str | Path | None, today: date
) -> None:
    """Check that a list of withdrawn certificates may speak of one: signed with the same key, and not after today.

    Parameters
    ----------
    seal : signature of the certificate; None for a list by itself.
    key : PEM file with the public key that must have signed the list; None for that of the certificate, or any.

    Raises
    ------
    CalibrationError
        If it is not signed, was changed, was signed by another key, or is of a later day.
    RefusedError
        If the key cannot be used.
    """
    check_sealed(path, listed, key)
    if seal is not None and listed.public_key != seal.public_key:
        raise CalibrationError(
            f"{path}: signed by key {fingerprint(listed.public_key)}, the certificate by key"
            f" {fingerprint(seal.public_key)}",
            remedy="use the list of the laboratory that signed the certificate",
        )
    _check_clock(str(path), listed.signed_at, today)


def _check_clock(name: str, signed_at: str, today: date) -> None:
    if problem := find_clock_problem(signed_at, today):
        raise CalibrationError(f"{name} {problem}", remedy="set the clock: whether it lapsed is not known")


def _read(path: Path, kind: type[_Kind]) -> _Kind:
    stated, remedy = str(kind.__dataclass_fields__["format"].default), _AGAIN
    try:
        data = read_foreign(path, _MOST_BYTES)
        content = parse_json(data) if data.lstrip().startswith(b"{") else None
        if not isinstance(content, Mapping) or content.get("format") != stated:
            what, remedy = _MEANT[stated]
            raise ValueError(f"it is not {what}")
        filled = fill_from_mapping(kind, content)
        if odd := find_odd_value(kind, filled):
            raise ValueError(odd)
        if isinstance(filled, CertificateSeal) and filled.valid_until is not None:
            date.fromisoformat(filled.valid_until)
        if filled.signed_at:
            datetime.fromisoformat(filled.signed_at)
    except (OSError, ValueError, TypeError, KeyError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise CalibrationError(f"{path} cannot be read: {why}", remedy=remedy) from error
    return filled


def _statement(content: CertificateSeal | WithdrawnList) -> bytes:
    fields: dict[str, Any] = {name: value for name, value in asdict(content).items() if name != "signature"}
    text = json.dumps(fields, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return f"{content.format} signature\n{text}\n".encode()
