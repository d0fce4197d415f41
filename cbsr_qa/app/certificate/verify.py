"""Whether a file is that of a certificate that holds: unchanged, signed, neither lapsed nor withdrawn."""

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Final

from cbsr_qa.app.certificate.files import SIGNATURE
from cbsr_qa.app.certificate.verdict import find_verdict_problem
from cbsr_qa.calibration.file.certified import (
    CertificateSeal,
    check_list,
    check_sealed,
    find_clock_problem,
    read_seal,
    read_withdrawn,
)
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import CalibrationError, StoreError
from cbsr_qa.domain.results.certificate_records import StoredCertificate
from cbsr_qa.domain.results.report import Banner, CommandOutcome
from cbsr_qa.domain.results.signature import fingerprint
from cbsr_qa.report.page import answer
from cbsr_qa.store.opening import open_existing, open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.foreign import read_foreign

_MOST_BYTES: Final = 2**24
#: Where page and XML state the number of their certificate.
_NUMBER: Final = re.compile(
    rb"<title>Calibration certificate ([A-Za-z0-9.-]{1,96})</title>"
    rb"|<dcc:uniqueIdentifier>([A-Za-z0-9.-]{1,96})</dcc:uniqueIdentifier>"
)
_NOT_PINNED: Final = (
    "no key was pinned, so anybody may have made it: --public-key FILE requires the key that you trust"
)
_OR_PIN: Final = "; --public-key FILE checks it by the key of its laboratory alone"
_NOT_LOOKED_UP: Final = (
    "not looked up in the database of the laboratory: whether it was replaced or revoked, or its run altered, is not"
    " known"
)
_ONLY_LISTED: Final = (
    "not looked up in the database of the laboratory: what was replaced or revoked after the list was signed, on"
    " {day}, is not known"
)


@dataclass(frozen=True, slots=True)
class VerifiedCertificate:
    """Whether a file is that of a certificate that holds.

    Parameters
    ----------
    why : why it is not valid; empty if it is.
    number : of the certificate; None if the file states none.
    signed_by : fingerprint of the key whose signature fits; None if none was found to fit.
    pinned : whether that is the key that was asked for.
    recorded : whether the database has this certificate, and its run with every frame is as it was stored; rows that
        were removed from the end of a run together with their links are not noticed.
    valid_until : None if no validity is stated, or nothing is known of it.
    list_of : day on which the list of withdrawn certificates was signed; None without one that counts.
    """

    file: Path
    valid: bool
    why: str
    number: str | None
    signed_by: str | None
    pinned: bool
    recorded: bool
    valid_until: str | None
    list_of: str | None


def verify_certificate(
    path: Path,
    *,
    public_key: Path | None = None,
    signature: Path | None = None,
    withdrawn: Path | None = None,
    database: str | None = None,
    today: date | None = None,
) -> CommandOutcome[VerifiedCertificate]:
    """Verify page or XML of a certificate, by its signature file and by the database, whichever is there.

    Exit code 1 unless it is valid, signed by the pinned key or recorded in the database.

    Parameters
    ----------
    public_key : PEM file with the key that must have signed it; None: the database must have it.
    signature : signature file; by default beside the file.
    withdrawn : list of withdrawn certificates, signed with the same key as the certificate.
    database : URL or path; by default the usual one, if it exists.
    today : day on which it must be valid; None for the computer's (UTC).

    Raises
    ------
    RefusedError
        If the key or the database cannot be used.
    """
    check = _Check(path, public_key, today or datetime.now(UTC).date())
    try:
        data = read_foreign(path, _MOST_BYTES)
    except OSError as error:
        return _answer(check, f"it cannot be read: {error.strerror or error}", [])
    check.read_number(data)
    whys = [*check.find_signature_problems(signature), *check.find_record_problems(database)]
    if check.seal is None and check.record is None and not whys:
        whys.append("it is unknown who issued it: there is no signature file beside it, and no database has it")
    whys += [*check.find_digest_problems(hashlib.sha256(data).hexdigest()), *check.find_validity_problems()]
    whys += check.find_listed_problems(withdrawn)
    if check.signed_by and public_key is None and check.record is None and not whys:
        whys.append(_NOT_PINNED)
    warnings: list[str] = []
    if not check.looked_up:
        warnings.append(_NOT_LOOKED_UP if check.list_of is None else _ONLY_LISTED.format(day=check.list_of))
    return _answer(check, "; ".join(dict.fromkeys(whys)), warnings)


class _Check:
    """One file, and what is known of it."""

    def __init__(self, path: Path, public_key: Path | None, today: date) -> None:
        self.path, self.public_key, self.today = path, public_key, today
        self.number: str | None = None
        self.seal: CertificateSeal | None = None
        self.record: StoredCertificate | None = None
        self.signed_by: str | None = None
        self.looked_up = False
        self.list_of: str | None = None

    def read_number(self, data: bytes) -> None:
        found = _NUMBER.search(data)
        self.number = None if found is None else (found[1] or found[2]).decode()

    def find_signature_problems(self, signature: Path | None) -> Iterator[str]:
        """Read the signature file, and yield what is wrong with it; without one, what is missing."""
        beside = signature or self.path.with_name(f"{self.path.name.removesuffix(self.path.suffix)}{SIGNATURE}")
        if signature is None and not beside.exists():
            if self.public_key is not None:
                yield f"it is not signed: there is no {beside.name} beside it, and a signature is required"
            return
        try:
            self.seal = read_seal(beside)
            check_sealed(beside, self.seal, self.public_key)
        except CalibrationError as error:
            yield error.reason
            return
        self.signed_by = fingerprint(self.seal.public_key)
        if self.number is not None and self.seal.number != self.number:
            yield f"its signature is that of certificate {self.seal.number}"
        self.number = self.seal.number

    def find_record_problems(self, database: str | None) -> Iterator[str]:
        """Look the certificate up in the database, if there is one, and yield what is wrong with it there."""
        url = database_url(database)
        store = open_existing(url) if database is None else open_store(url, create=False)
        if store is None:
            return
        with store:
            try:
                self.looked_up = self.number is not None
                self.record = store.certificates.find(self.number) if self.number is not None else None
                if self.record is not None:
                    yield from _find_run_problems(store, self.record)
            except StoreError as error:
                self.record = None
                yield error.reason
                return
            missing = (
                self.record is None and self.number is not None and store.certificates.is_numbered_here(self.number)
            )
            self.looked_up = self.record is not None or missing
            if self.record is None and (missing or database is not None or self.public_key is None):
                unknown = f"{store.shown} has no certificate {self.number or 'of this file'}"
                unknown += ", though its run was begun there" if missing else ""
                yield unknown if self.public_key or missing else f"{unknown}{_OR_PIN}"
        if self.record is not None and self.record.withdrawals:
            yield f"certificate {self.number} was {self.record.withdrawn}"

    def find_digest_problems(self, sha256: str) -> Iterator[str]:
        """Yield where the file is neither page nor XML of the certificate."""
        issued = None if self.record is None else self.record.issued
        known = [] if self.seal is None else [(self.seal.html_sha256, self.seal.dcc_sha256)]
        if issued is not None:
            known.append((hashlib.sha256(issued.html).hexdigest(), hashlib.sha256(issued.dcc).hexdigest()))
        if any(sha256 not in digests for digests in known):
            yield "the file was changed since it was issued: its SHA-256 is another one"

    def find_validity_problems(self) -> Iterator[str]:
        signed_at = "" if self.seal is None else self.seal.signed_at
        issued_at = signed_at if self.record is None else self.record.issued.issued_at.isoformat()
        if issued_at and (problem := find_clock_problem(issued_at, self.today)):
            yield f"it {problem}"
        if self.valid_until is not None and date.fromisoformat(self.valid_until) < self.today:
            yield f"it lapsed: it was valid until {self.valid_until}"

    def find_listed_problems(self, withdrawn: Path | None) -> list[str]:
        """Return what a list of withdrawn certificates says of it."""
        if withdrawn is None or self.number is None:
            return []
        try:
            listed = read_withdrawn(withdrawn)
            check_list(withdrawn, listed, self.seal, self.public_key, self.today)
        except CalibrationError as error:
            return [error.reason]
        self.list_of = listed.signed_at[:10]
        entry = listed.find(self.number, "")
        return [] if entry is None else [f"certificate {self.number} was {entry.words}"]

    @property
    def valid_until(self) -> str | None:
        if self.record is not None:
            return self.record.issued.valid_until
        return None if self.seal is None else self.seal.valid_until


def _find_run_problems(store: Repository, record: StoredCertificate) -> Iterator[str]:
    """Yield why a run is no longer one to certify. StoreError if it, a frame or its calibration was altered."""
    chain = store.runs.load(record.issued.run).chain
    store.calibrations.load_file(record.issued.calibration)
    run = record.issued.run
    if not chain.chained:
        yield f"run {run}: {chain.words}"
    if problem := find_verdict_problem(store, run):
        yield problem


def _answer(check: _Check, why: str, warnings: list[str]) -> CommandOutcome[VerifiedCertificate]:
    verified = VerifiedCertificate(
        file=check.path,
        valid=not why,
        why=why,
        number=check.number,
        signed_by=check.signed_by,
        pinned=check.signed_by is not None and check.public_key is not None,
        recorded=check.record is not None,
        valid_until=check.valid_until,
        list_of=check.list_of,
    )
    facts = [("Number", verified.number or "none stated"), ("Signed by", verified.signed_by or "nobody")]
    facts += [("Valid until", verified.valid_until or "not stated")]
    facts += [] if verified.list_of is None else [("List of", verified.list_of)]
    outcome = answer(verified, f"{check.path} is valid", "", facts, warnings=warnings)
    if not why:
        return outcome
    banner = Banner("fail", "✗", f"{check.path} is not valid", why)
    if why == _NOT_PINNED:
        banner = Banner("marginal", "≈", f"{check.path} is unchanged; who signed it is not known", why)
    return replace(outcome, page=replace(outcome.page, banner=banner), exit_code=1)
