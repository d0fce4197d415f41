"""Certificates of a database: listed, revoked, written again; the signed list of those that no longer hold."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from cbsr_qa.app.certificate.files import list_contents, write_files
from cbsr_qa.app.certificate.verdict import find_verdict_problem
from cbsr_qa.calibration.file.certified import Withdrawn, WithdrawnList, read_withdrawn, sign, to_text
from cbsr_qa.calibration.file.hdf5 import calibration_of
from cbsr_qa.calibration.file.keys import signing_key
from cbsr_qa.config.paths import database_url
from cbsr_qa.config.serials import validate_operator, validate_reason
from cbsr_qa.domain.errors import CalibrationError, ConfigError, RefusedError
from cbsr_qa.domain.results.certificate import NOT_STATED
from cbsr_qa.domain.results.certificate_records import StoredCertificate
from cbsr_qa.domain.results.report import CommandOutcome, Section
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import plural, text_table
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.clock import RealClock
from cbsr_qa.system.files import write_atomically, writing
from cbsr_qa.system.foreign import read_foreign


@dataclass(frozen=True, slots=True)
class ListedCertificate:
    """A certificate in one line.

    Parameters
    ----------
    withdrawn : what became of it; None while it stands.
    run_problem : why its run could not be certified now; None if it could, or the certificate does not stand.
    """

    number: str
    serial: str
    run: str
    issued_at: datetime
    valid_until: str | None
    replaces: str | None
    withdrawn: str | None
    run_problem: str | None

    @classmethod
    def from_stored(cls, stored: StoredCertificate, run_problem: str = "") -> "ListedCertificate":
        issued = stored.issued
        return cls(
            issued.number,
            stored.serial,
            issued.run,
            issued.issued_at,
            issued.valid_until,
            issued.replaces,
            stored.withdrawn or None,
            run_problem or None,
        )


@dataclass(frozen=True, slots=True)
class CertificateList:
    """Certificates in the order they were issued."""

    certificates: tuple[ListedCertificate, ...]


@dataclass(frozen=True, slots=True)
class WrittenFiles:
    """Files that were written for a certificate, or the list of withdrawn ones, with how many it names."""

    files: tuple[Path, ...]
    certificates: int


def list_certificates(serial: str | None, *, database: str | None = None) -> CommandOutcome[CertificateList]:
    """List the certificates of one sensor, or of all. StoreError without such a sensor, or if a run was altered."""
    with open_store(database_url(database), create=False) as store:
        certificates = store.certificates.list_all(serial)
        problems = _find_problems(store, certificates)
    listed = tuple(ListedCertificate.from_stored(one, problems.get(one.issued.number, "")) for one in certificates)
    rows = [
        (
            one.number,
            one.serial,
            f"{one.issued_at:%Y-%m-%d}",
            one.valid_until or NOT_STATED,
            one.withdrawn or (f"no, but {one.run_problem}" if one.run_problem else ""),
        )
        for one in listed
    ]
    table = text_table("", ("number", "sensor", "issued", "valid until", "withdrawn"), rows)
    outcome = answer(CertificateList(listed), plural(len(listed), "certificate"))
    return CommandOutcome(outcome.result, outcome.page, (Section("Certificates", (table,)),) if listed else ())


def revoke_certificate(
    number: str, *, by: str, why: str, database: str | None = None
) -> CommandOutcome[ListedCertificate]:
    """Revoke a certificate; its files and its row stay, and the reason is kept under the chain of its run.

    Raises
    ------
    ConfigError
        If the reason is missing, or it or the name cannot be used.
    StoreError
        If there is no such certificate, it does not stand, or its run was altered or begun in another database.
    """
    if not why.strip():
        raise ConfigError(
            "a revocation needs --reason", remedy="say why: verify and the list of withdrawn ones show it"
        )
    operator, reason = validate_operator(by) or NOT_STATED, validate_reason(why)
    with open_store(database_url(database), create=False) as store:
        revoked = ListedCertificate.from_stored(store.certificates.revoke(number, operator=operator, why=reason))
    return answer(revoked, f"certificate {number} revoked", reason, [("Sensor", revoked.serial)])


def copy_certificate(number: str, folder: Path, *, database: str | None = None) -> CommandOutcome[WrittenFiles]:
    """Write the files of a certificate again, byte for byte; those that are there stay.

    RefusedError if another file has a name of one, or one cannot be written; nothing is written then.
    """
    with open_store(database_url(database), create=False) as store:
        stored = store.certificates.load(number)
    missing: dict[str, bytes] = {}
    for ending, data in list_contents(stored.issued).items():
        if not (path := folder / f"{number}{ending}").exists():
            missing[ending] = data
            continue
        try:
            is_same = read_foreign(path, len(data)) == data
        except OSError:  # larger, no regular file, or not to be read
            is_same = False
        if not is_same:
            raise RefusedError(f"{path} exists already, and is another file", remedy="name another folder")
    with write_files(folder, number, missing) as paths:
        written = WrittenFiles(tuple(paths.values()), 1)
    warnings = [f"it was {stored.withdrawn}"] if stored.withdrawals else []
    return answer(
        written, f"certificate {number} written again", printed=[("Folder", str(folder))], warnings=warnings
    )


def write_withdrawn(path: Path, key: Path, *, database: str | None = None) -> CommandOutcome[WrittenFiles]:
    """Write the signed list of certificates that were replaced or revoked; an earlier list there is replaced.

    Raises
    ------
    RefusedError
        If the key cannot be used, or the file is something else, names a certificate that this database does not, or
        cannot be written.
    """
    own_key, earlier = signing_key(key), set()
    if path.exists():
        try:
            earlier = {one.number for one in read_withdrawn(path).withdrawn}
        except CalibrationError as error:
            raise RefusedError(
                f"{path} exists, and is not a list of withdrawn certificates", remedy="name another file"
            ) from error
    with open_store(database_url(database), create=False) as store:
        certificates = store.certificates.list_all()
        withdrawn = _list_withdrawn(store, certificates)
        warnings = [*own_key.warnings]
        warnings += [
            f"certificate {number} stands, and is not listed: {problem}; `cbsr-qa certificate revoke` it"
            for number, problem in _find_problems(store, certificates).items()
        ]
    if lost := sorted(earlier - {one.number for one in withdrawn}):
        others = f", nor {len(lost) - 1} more of that list" if len(lost) > 1 else ""
        raise RefusedError(
            f"{path} names certificate {lost[0]}, which is not withdrawn in this database{others}",
            remedy="if it is the list of another database, name another file; else restore the database from a copy",
        )
    signed = sign(WithdrawnList(withdrawn), own_key, RealClock().wall())
    with writing(path), write_atomically(path) as file:
        file.write(to_text(signed).encode())
    written = WrittenFiles((path,), len(withdrawn))
    headline = f"{plural(len(withdrawn), 'withdrawn certificate')} listed"
    return answer(written, headline, printed=[("File", str(path))], warnings=warnings)


def _find_problems(store: Repository, certificates: Sequence[StoredCertificate]) -> dict[str, str]:
    """Return why runs of certificates that stand could not be certified now, by number."""
    continued = store.certificates.find_continued()
    standing = {one.issued.number: one.issued.run for one in certificates if not one.withdrawals}
    problems = {number: find_verdict_problem(store, run) for number, run in standing.items() if run in continued}
    return {number: problem for number, problem in problems.items() if problem}


def _list_withdrawn(store: Repository, certificates: Sequence[StoredCertificate]) -> tuple[Withdrawn, ...]:
    """Return the withdrawn certificates; the calibration is named where no other certificate of it stands."""
    standing = {one.issued.calibration for one in certificates if not one.withdrawals}
    return tuple(
        Withdrawn(
            one.issued.number,
            "" if one.issued.calibration in standing else _digest(store, one.issued.calibration),
            one.withdrawn,
        )
        for one in certificates
        if one.withdrawals
    )


def _digest(store: Repository, calibration: str) -> str:
    file, digest = store.calibrations.load_file(calibration)
    return calibration_of(file, issued=digest).digest
