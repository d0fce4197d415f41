"""Content of a certificate, from a stored run that issued a calibration."""

import hashlib
import json
from calendar import monthrange
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from math import dist, hypot
from pathlib import Path
from typing import Any, Final

from cbsr_qa.app.certificate.checked_loads import check_loads
from cbsr_qa.app.certificate.request import CertificateRequest, choose_settings
from cbsr_qa.app.certificate.verdict import RunVerdict
from cbsr_qa.app.run.decided_again import check_decided, judging_recipe
from cbsr_qa.calibration.file.hdf5 import calibration_of
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.calibration.uncertainty.budget import evaluate_forces
from cbsr_qa.config.merging import content_digest
from cbsr_qa.domain.errors import CalibrationError, RefusedError, StoreError
from cbsr_qa.domain.plan.plan import CertificateSettings
from cbsr_qa.domain.plan.standards import find_doubtful_dates, find_overdue
from cbsr_qa.domain.results.calibration import Calibration as IssuedCalibration
from cbsr_qa.domain.results.certificate import Certificate, Replacement, is_reference_known
from cbsr_qa.domain.results.certificate_records import StoredCertificate
from cbsr_qa.domain.results.expanded_force import Result
from cbsr_qa.domain.run.gate import GateOutcome, gate_warnings
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.results.analyses import StoredAnalysis

#: Most places of the table of results: more do not fit on the page.
_MOST_PLACES: Final = 9


@dataclass(frozen=True, slots=True)
class Composed:
    """A certificate that is not issued yet.

    Parameters
    ----------
    key : file of the private key that signs it; None: it is not signed.
    checked_link : digest of the last link of its run, which was checked up to there.
    """

    certificate: Certificate
    key: Path | None
    checked_link: str


def compose_certificate(store: Repository, run: str, request: CertificateRequest, now: datetime) -> Composed:
    """Compose the certificate of a run.

    Raises
    ------
    StoreError
        If the run was altered or its chain removed, or no certificate of it may be issued here (see
        :meth:`~cbsr_qa.store.results.certificates.Certificates.check_allowed`).
    RefusedError
        If the sensor did not pass, the run issued no calibration that tells force, an instrument or standard was
        overdue on the day of calibration, the clock is before that day, or the validity has ended.
    ConfigError
        If the settings are missing or not allowed.
    """
    replaced = store.certificates.check_allowed(run, request.replaces or None)
    record = store.runs.load(run)
    stored = store.analyses.load(run, checked_link=record.chain_head)
    if not record.chain.chained:
        raise StoreError(f"run {run} is not certified: {record.chain.words}", remedy="test the sensor again")
    analysis, verdict = _require_pass(store, record, stored)
    configuration = store.runs.read_configuration(run)
    recipe = judging_recipe(store, run, analysis)
    check_decided(record, analysis, recipe.limits)
    settings, key = choose_settings(request, configuration)
    issued = _load_calibration(store, analysis, record.chain_head)
    performed, valid_until = _date_calibration(record, issued, settings, now)
    assert issued.validity.force_N is not None
    places_mm = choose_places(issued)
    forces = evaluate_forces(issued, None, places_mm, result=Result.ON_THE_DAY)
    in_use = evaluate_forces(issued, None, places_mm, result=Result.IN_USE)
    judged_by = settings if is_reference_known(record.identity, issued.standards) else None
    checked, left_out = check_loads(record, recipe, Calibration(issued), judged_by)
    certificate = Certificate(
        number=number_certificate(settings.prefix, run, store.certificates.count(run)),
        issued_at=now,
        settings=settings,
        customer=request.customer,
        identity=record.identity,
        calibration=issued.calibration,
        calibration_digest=issued.digest,
        performed=performed,
        recipe_digest=content_digest(_recipe_content(analysis, configuration)),
        verdict=verdict,
        sensor=f"{issued.sensor_type.name}, {issued.sensor_type.electrodes.count} electrodes",
        head=issued.indenter.words(),
        temperature_C=issued.validity.temperature_C,
        range_N=issued.validity.force_N,
        radius_mm=issued.validity.radius_mm,
        standards=issued.standards,
        forces=forces,
        forces_in_use=in_use,
        checked=checked,
        left_out=left_out,
        deviations=list_deviations(record, stored),
        reduced=issued.validity.reduced,
        valid_until=valid_until,
        replaced=None if replaced is None else _describe_replaced(replaced, request.why),
    )
    return Composed(certificate, key, record.chain_head)


def _date_calibration(
    record: RunRecord, issued: IssuedCalibration, settings: CertificateSettings, now: datetime
) -> tuple[tuple[date, date], date | None]:
    """Return first and last day of a calibration, and the last of its validity; refuse days that cannot be stated."""
    begun, ended = record.identity.started_at.astimezone(UTC).date(), datetime.fromisoformat(issued.issued_at).date()
    due_by_name = {f"{one.role} ({one.driver})": one.calibration_due for one in record.identity.instruments}
    refused = f"run {record.identity.run} is not certified"
    for problem in (*find_overdue(due_by_name, begun), *find_doubtful_dates(issued.standards, begun)):
        raise RefusedError(
            f"{refused}: {problem}",
            remedy="test the sensor again with instruments and standards that are in date",
        )
    if now.date() < ended:
        raise RefusedError(
            f"{refused}: by the clock of this computer it is {now.date()}, and the calibration was made on {ended}",
            remedy="set the clock",
        )
    months = settings.validity_months
    valid_until = None if months is None else add_months(ended, months)
    if valid_until is not None and valid_until < now.date():
        raise RefusedError(
            f"{refused}: its validity of {months} months ended on {valid_until}", remedy="test the sensor again"
        )
    return (begun, ended), valid_until


def list_deviations(record: RunRecord, stored: Sequence[StoredAnalysis]) -> tuple[str, ...]:
    """Return what was not as the recipe and the gate intend (ISO/IEC 17025, 7.8.2.1 n), each once."""
    overridden = gate_warnings(one for one in record.gate if one.outcome is GateOutcome.OVERRIDDEN)
    warnings = (*stored[0].warnings, *stored[-1].warnings, *gate_warnings(record.gate))
    return tuple(dict.fromkeys((*overridden, *warnings)))


def _describe_replaced(replaced: StoredCertificate, why: str) -> Replacement:
    dcc_sha256 = hashlib.sha256(replaced.issued.dcc).hexdigest()
    return Replacement(replaced.issued.number, why, dcc_sha256, replaced.withdrawn)


def number_certificate(prefix: str, run: str, earlier: int) -> str:
    """Return the number of a certificate: prefix and run, and which it is of the run where others were issued."""
    return f"{prefix}-{run}-R{earlier}" if earlier else f"{prefix}-{run}"


def add_months(day: date, months: int) -> date:
    """Return the same day some months later, or the last of that month."""
    year, month = divmod(day.month - 1 + months, 12)
    year, month = day.year + year, month + 1
    return date(year, month, min(day.day, monthrange(year, month)[1]))


def choose_places(issued: IssuedCalibration) -> tuple[tuple[float, float], ...]:
    """Return places of the calibration's loads, at most nine: the centre, then each the farthest from those."""
    places = sorted({(place.x_mm, place.y_mm) for place in issued.baseline}, key=lambda place: (hypot(*place), place))
    chosen = places[:1]
    while len(chosen) < min(_MOST_PLACES, len(places)):
        chosen.append(max(places, key=lambda place: min(dist(place, other) for other in chosen)))
    return tuple(place for place in places if place in chosen)


def _recipe_content(analysis: StoredAnalysis, configuration: str) -> Any:
    """Return the content of the recipe that an analysis follows from."""
    return json.loads(configuration)["recipe"] if analysis.adoption is None else json.loads(analysis.adoption.recipe)


def _require_pass(
    store: Repository, record: RunRecord, stored: Sequence[StoredAnalysis]
) -> tuple[StoredAnalysis, str]:
    """Return the latest analysis of a run that passed and issued a calibration, and its verdict in words."""
    run, serial = record.identity.run, record.identity.sensor.serial
    if not stored:
        raise RefusedError(f"run {run} of sensor {serial} is not certified: it was {record.end} and has no result")
    latest = stored[0]
    verdict = RunVerdict.from_analyses(store, run, stored)
    if not verdict.passes:
        raise RefusedError(
            f"sensor {serial} is not certified: the verdict of run {run} is {verdict.outcome}: {verdict.reason}"
        )
    if latest.calibration is None:
        raise RefusedError(
            f"run {run} is not certified: it issued no calibration: {latest.calibration_why}",
            remedy="name another run of the sensor; cbsr-qa runs lists them",
        )
    return latest, verdict.words


def _load_calibration(store: Repository, analysis: StoredAnalysis, checked_link: str) -> IssuedCalibration:
    assert analysis.calibration is not None
    file, digest = store.calibrations.load_file(analysis.calibration, checked_link=checked_link)
    issued = calibration_of(file, issued=digest)
    if issued.force is None or issued.validity.force_N is None:
        raise CalibrationError(
            f"run {analysis.run} is not certified: its calibration tells no force: {issued.no_force}"
        )
    return issued
