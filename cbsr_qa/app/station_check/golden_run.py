"""The run of a golden sensor within a check of its station."""

from typing import Final

from cbsr_qa.app.run.console import RunConsole
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.app.station_check.bench import BenchFindings, Confirm
from cbsr_qa.app.station_check.golden_history import compare_golden, golden_history
from cbsr_qa.app.station_check.request import GOLDEN_RECIPE, CheckRequest
from cbsr_qa.domain.errors import CbsrError, StoppedError
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult
from cbsr_qa.store.repository import Repository

#: Lines that must pass before the golden sensor is pressed.
_NEEDED: Final = ("identity", "together", "safe state", "closing")


def _subject(serial: str) -> str:
    return f"golden sensor {serial}"


def describe_placing(serial: str) -> str:
    """Ask for a golden sensor."""
    return f"Put golden sensor {serial} on the station"


def may_press(serial: str, findings: BenchFindings, confirm: Confirm) -> bool:
    """Whether the golden sensor may be run; a line says why not."""
    reason = ""
    if any(line.outcome is CheckOutcome.FAILED and line.name in _NEEDED for line in findings.lines):
        reason = "the bench is not whole"
    elif confirm is not None and not confirm(describe_placing(serial)):
        reason = "the operator did not put it on the station"
    if reason:
        findings.lines.append(CheckResult("run", CheckOutcome.NOT_DONE, said=reason, subject=_subject(serial)))
    return not reason


def run_golden(
    request: CheckRequest,
    serial: str,
    findings: BenchFindings,
    store: Repository,
    console: RunConsole,
) -> RunIdentity | None:
    """Run the golden sensor and add a line for each of its values; return the run, or None if not started."""
    subject = _subject(serial)

    def line(outcome: CheckOutcome, said: str, remedy: str = "") -> None:
        findings.lines.append(CheckResult("run", outcome, said=said, remedy=remedy, subject=subject))

    run_request = RunRequest(
        station=request.station,
        recipe=GOLDEN_RECIPE,
        serial=serial,
        operator=request.operator,
        sensor_type=request.sensor_type,
        material=request.material,
        database=request.database,
        golden=True,
    )
    try:
        outcome = run_sensor(run_request, console)
    except StoppedError:
        raise
    except CbsrError as error:
        line(CheckOutcome.FAILED, error.reason, error.remedy)
        return None
    record, identity = outcome.result.record, outcome.result.record.identity
    if record.end is not EndReason.FINISHED:
        line(CheckOutcome.FAILED, f"{identity.words} was {record.end}: {record.end_detail}", "measure it again")
        return identity
    line(CheckOutcome.OK, f"{identity.words}, {record.station_s / 60:.1f} min of station time")
    history = golden_history(store, outcome.run)
    measured = outcome.result.measurements
    findings.lines += compare_golden(measured, history, station=identity.station, subject=subject)
    return identity
