"""Issuing certificates: of one sensor, or of every sensor of a batch."""

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cache, partial
from math import isfinite
from pathlib import Path

from cbsr_qa.app.certificate.compose import Composed, compose_certificate
from cbsr_qa.app.certificate.files import DCC, HTML, SIGNATURE, find_taken, list_contents, write_files
from cbsr_qa.app.certificate.request import CertificateRequest
from cbsr_qa.app.reanalyse.workers import local_workers
from cbsr_qa.calibration.file.certified import CertificateSeal, sign, to_text
from cbsr_qa.calibration.file.keys import SigningKey, signing_key
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import CbsrError, RefusedError
from cbsr_qa.domain.plan.standards import StandardRole
from cbsr_qa.domain.results.certificate import NOT_STATED, Certificate
from cbsr_qa.domain.results.certificate_records import IssuedCertificate
from cbsr_qa.domain.results.expanded_force import ExpandedForce
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.report import Banner, CommandOutcome
from cbsr_qa.domain.results.signature import fingerprint
from cbsr_qa.report.certificate import render_certificate
from cbsr_qa.report.certificate_texts import state_conformity
from cbsr_qa.report.dcc import render_dcc
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import plural
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.clock import RealClock

_NOT_SIGNED = (
    "it is not signed: nobody outside of this database can check it; --key FILE, or signing_key of the station"
)


@dataclass(frozen=True, slots=True)
class CertifiedForce:
    """A force at a place with its expanded uncertainty on the day of calibration, and in use.

    Parameters
    ----------
    dof, dof_in_use : effective degrees of freedom; None if infinite.
    not_stated, not_stated_in_use : inputs that nothing gives a number for, which U lacks.
    """

    place_mm: tuple[float, float]
    force_N: float
    U_N: float
    k: float
    dof: float | None
    not_stated: tuple[str, ...]
    U_in_use_N: float
    k_in_use: float
    dof_in_use: float | None
    not_stated_in_use: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class CertifiedStandard:
    """A reference standard; ``number`` and ``due`` are None where it was not stated."""

    role: str
    number: str | None
    due: str | None
    stated: bool


@dataclass(frozen=True, slots=True)
class CertificateFiles:
    """A certificate that was issued: its number, its files, and what it states."""

    number: str
    html: Path
    dcc: Path
    statement: str
    force: tuple[CertifiedForce, ...]
    standards: tuple[CertifiedStandard, ...]


@dataclass(frozen=True, slots=True)
class RefusedCertificate:
    """A sensor of a batch that got no certificate."""

    serial: str
    run: str
    reason: str
    remedy: str


@dataclass(frozen=True, slots=True)
class BatchCertificates:
    """Certificates of a batch: those that were issued, and sensors that got none."""

    batch: str
    issued: tuple[CertificateFiles, ...]
    refused: tuple[RefusedCertificate, ...]


def issue_certificate(
    serial: str, request: CertificateRequest, *, database: str | None = None
) -> CommandOutcome[CertificateFiles]:
    """Issue the certificate of the latest run of a sensor.

    Parameters
    ----------
    serial : serial number, or a run.

    Raises
    ------
    CbsrError
        As :func:`~cbsr_qa.app.certificate.compose.compose_certificate`; also if a file exists or cannot be written,
        the key cannot be used, or what is to be replaced does not stand. Nothing is issued then.
    """
    request = request.validate()
    with open_store(database_url(database), create=False) as store:
        files, key = _issue(store, store.runs.resolve(serial), request)
    signed_by = "" if key is None else fingerprint(key.public_key)
    facts = [("Number", files.number), ("Signed by", f"key {signed_by}" if signed_by else "nobody")]
    printed = [("Page", str(files.html)), ("XML", str(files.dcc))]
    printed += [("Signature", str(request.folder / f"{files.number}{SIGNATURE}"))] if signed_by else []
    warnings = [*_warn_of_customer(request), *([_NOT_SIGNED] if key is None else key.warnings)]
    return answer(files, f"certificate of {serial} issued", files.statement, facts, printed, warnings)


def issue_batch(
    batch: str, request: CertificateRequest, count: Callable[[int, int], None], *, database: str | None = None
) -> CommandOutcome[BatchCertificates]:
    """Issue the certificate of the latest run of every sensor of a batch, by as many processes as processors.

    Sensors that cannot be certified are named, and do not hinder the others; exit code 1 then.

    Parameters
    ----------
    count : called with the number of sensors that are done, and of all.

    Raises
    ------
    RefusedError
        If the batch has no run, or a replacement was asked for.
    """
    request = request.validate()
    if request.replaces:
        raise RefusedError(
            "--replaces with --batch", remedy="a certificate is replaced by that of one sensor: name it"
        )
    url = database_url(database)
    results: dict[str, CertificateFiles | RefusedCertificate] = {}
    with open_store(url, create=False) as store:
        latest = {line.serial: line.run for line in store.fleet.read_lines(RunSelection(batch=batch, checks=False))}
        if not latest:
            raise RefusedError(f"no stored run is of batch {batch[:64]!r}", remedy="cbsr-qa runs lists them")
        jobs = list(latest.items())
        workers = local_workers(min(os.cpu_count() or 1, len(jobs)), partial(_issue_in_worker, url, request))
        for (serial, run), result in workers.run_jobs(jobs):
            results[serial] = RefusedCertificate(serial, run, result, "") if isinstance(result, str) else result
            count(len(results), len(jobs))
    in_order = [results[serial] for serial in latest]
    issued = tuple(one for one in in_order if isinstance(one, CertificateFiles))
    refused = tuple(one for one in in_order if isinstance(one, RefusedCertificate))
    warnings = [": ".join(filter(None, (f"sensor {one.serial} got none", one.reason, one.remedy))) for one in refused]
    if issued:
        warnings += [*_warn_of_customer(request), *(() if request.key is None else signing_key(request.key).warnings)]
    outcome = answer(
        BatchCertificates(batch, issued, refused),
        f"{plural(len(issued), 'certificate')} of batch {batch} issued",
        f"{plural(len(refused), 'sensor')} got none" if refused else "",
        printed=[("Folder", str(request.folder))],
        warnings=warnings,
    )
    if not refused:
        return outcome
    banner = replace(outcome.page.banner, tone="marginal", symbol="≈")
    if not issued:
        banner = Banner("fail", "✗", f"no certificate of batch {batch} issued", banner.reason)
    return replace(outcome, page=replace(outcome.page, banner=banner), exit_code=1)


def _warn_of_customer(request: CertificateRequest) -> list[str]:
    """Return a warning of what a certificate lacks of its customer (ISO/IEC 17025, 7.8.2.1 e)."""
    options = (("--customer", request.customer.name), ("--customer-address", request.customer.address))
    missing = [option for option, text in options if not text]
    return [f'the customer is "{NOT_STATED}": give {" and ".join(missing)}'] if missing else []


def _issue_in_worker(
    url: str, request: CertificateRequest, job: tuple[str, str]
) -> CertificateFiles | RefusedCertificate:
    serial, run = job
    try:
        return _issue(_open_in_worker(url), run, request)[0]
    except CbsrError as error:
        return RefusedCertificate(serial, run, error.reason, error.remedy)


@cache  # statements are compiled once per opening, which takes a fifth of a certificate
def _open_in_worker(url: str) -> Repository:
    """Open a database for as long as a worker lives; the process that began it closes it last."""
    return open_store(url, create=False)


def _issue(store: Repository, run: str, request: CertificateRequest) -> tuple[CertificateFiles, SigningKey | None]:
    """Issue the certificate of a run; return it with its key, None if it is not signed."""
    now = RealClock().wall()
    composed = compose_certificate(store, run, request, now)
    certificate = composed.certificate
    if (path := find_taken(request.folder, certificate.number)) is not None:
        raise RefusedError(
            f"{path} exists already, and the database has no certificate {certificate.number}: an interrupted command"
            " left it, or the database lost it",
            remedy=f"if nobody was given it, remove {path.parent / certificate.number}.*; else test the sensor again:"
            " that gives another number",
        )
    key = None if composed.key is None else signing_key(composed.key)
    issued = _render(composed, key, now)
    with write_files(request.folder, certificate.number, list_contents(issued)) as paths:
        store.certificates.save(issued, checked_link=composed.checked_link)
    files = CertificateFiles(
        certificate.number,
        paths[HTML],
        paths[DCC],
        state_conformity(certificate),
        _list_forces(certificate),
        tuple(_list_standards(certificate)),
    )
    return files, key


def _render(composed: Composed, key: SigningKey | None, now: datetime) -> IssuedCertificate:
    certificate = composed.certificate
    signed_by = "" if key is None else fingerprint(key.public_key)
    html = render_certificate(certificate, signed_by).encode()
    dcc = render_dcc(certificate, signed_by)
    valid_until = None if certificate.valid_until is None else certificate.valid_until.isoformat()
    seal = CertificateSeal(
        certificate.number,
        certificate.identity.sensor.serial,
        certificate.calibration_digest,
        valid_until,
        hashlib.sha256(html).hexdigest(),
        hashlib.sha256(dcc).hexdigest(),
    )
    return IssuedCertificate(
        number=certificate.number,
        run=certificate.identity.run,
        calibration=certificate.calibration,
        issued_at=now,
        signatory=certificate.settings.signatory,
        valid_until=valid_until,
        replaces=None if certificate.replaced is None else certificate.replaced.number,
        why="" if certificate.replaced is None else certificate.replaced.why,
        html=html,
        dcc=dcc,
        signature=None if key is None else to_text(sign(seal, key, now)),
    )


def _list_forces(certificate: Certificate) -> tuple[CertifiedForce, ...]:
    def describe(one: ExpandedForce) -> tuple[float, float, float | None, tuple[str, ...]]:
        return one.U_N, one.k, one.dof if isfinite(one.dof) else None, one.not_stated

    both = zip(certificate.forces, certificate.forces_in_use, strict=True)
    return tuple(CertifiedForce(day.place_mm, day.force_N, *describe(day), *describe(use)) for day, use in both)


def _list_standards(certificate: Certificate) -> list[CertifiedStandard]:
    stated = {standard.role: standard for standard in certificate.standards}
    found = [(str(role), stated.get(str(role))) for role in StandardRole]
    return [
        CertifiedStandard(role, None, None, stated=False)
        if standard is None
        else CertifiedStandard(role, standard.certificate, standard.due, stated=True)
        for role, standard in found
    ]
