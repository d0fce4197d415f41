"""The station: its golden sensor, control charts, dates of instruments, released files, and what waits to be sent."""

from datetime import timedelta
from typing import Final

from cbsr_qa.app.gate.request import Asked, Finding
from cbsr_qa.app.station_charts import charts_after
from cbsr_qa.config.merging import BATCH_NOUN, FileContent, list_files
from cbsr_qa.config.paths import batch_file
from cbsr_qa.domain.plan.standards import find_doubtful_dates, find_overdue, past_due
from cbsr_qa.domain.run.station import CheckOutcome, CheckSeal, worst_check
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.clock import write_local_time

#: Time by which the clock of another computer may be ahead.
_CLOCKS: Final = timedelta(minutes=1)
#: Beginning of the subject of a check's lines about the golden sensor.
_SUBJECT: Final = "golden sensor"
#: What to do about a certificate of the future.
CORRECT_DATE: Final = "correct its date in the station file, or set the computer's clock"


def golden_measured(asked: Asked) -> Finding:
    """Judge the latest check of the station that measured a golden sensor, by its outcome and age."""
    station = asked.configuration.station.name
    remedy = "measure the golden sensor", f"cbsr-qa station check {station} --golden SERIAL"
    check = None if asked.store is None else asked.store.stations.read_latest_golden_check(station)
    if asked.store is None or check is None or check.golden_run is None:
        return Finding(False, f"no golden sensor was ever measured on station {station}", *remedy)
    golden_words = f"the golden sensor of {write_local_time(check.checked_at)}"
    golden_lines = [line for line in check.results if line.subject.startswith(_SUBJECT)]
    outcome = worst_check(golden_lines)
    unsigned = asked.store.key_id is not None and check.sealed in (CheckSeal.NONE, CheckSeal.DIGEST)
    if unsigned or outcome not in (CheckOutcome.OK, CheckOutcome.WARNING):
        problem = f"did not pass: {outcome}" if not unsigned else "is not signed, and a signing key is set"
        return Finding(False, f"{golden_words} {check.altered or problem} (check {check.check})", *remedy)
    age, hours = asked.now - check.checked_at, asked.settings.golden_hours
    if age < -_CLOCKS:
        return Finding(
            False, f"{golden_words} is later than this computer's clock", "set the clock, then measure it again"
        )
    if hours is not None and age > timedelta(hours=hours):
        clause = f"{golden_words} was measured {age / timedelta(hours=1):.1f} h ago; the station allows {hours:g} h"
        return Finding(False, clause, *remedy)
    most_runs = asked.settings.golden_runs
    if (
        most_runs is not None
        and asked.store.stations.count_runs_since(station, check.golden_run, most_runs) >= most_runs
    ):
        return Finding(
            False,
            f"{golden_words} was measured {most_runs} or more runs ago; the station allows fewer than {most_runs}",
            *remedy,
        )
    return Finding(True, f"{golden_words} passed")


def charts_in_control(asked: Asked) -> Finding:
    """Whether no chart signals; a station without references is not known to be in control."""
    station = asked.configuration.station.name
    charts = None if asked.store is None else charts_after(asked.store, station)
    if charts is None:
        clause = f"station {station} has no control chart with limits"
        return Finding(
            False, clause, "set the limits of one", f"cbsr-qa charts --station {station} --reference-runs N"
        )
    if charts.signals:
        clause = "; ".join(signal.words() for signal in charts.signals)
        command = f"cbsr-qa station check {station} --golden SERIAL, cbsr-qa charts --station {station}"
        return Finding(False, clause, "measure a golden sensor, and look at the charts", command)
    notes = f" ({'; '.join(charts.notes)})" if charts.notes else ""
    return Finding(True, f"none of {charts.charts} control charts signals{notes}")


def instruments_in_date(asked: Asked) -> Finding:
    """Look for instruments and standards whose date in the station file has passed, and for certificates of later."""
    station, today = asked.configuration.station, asked.now.date()
    due_by_name = {
        f"{instrument.role} ({instrument.driver})": instrument.calibration_due
        for instrument in station.instruments
        if instrument.calibration_due
    }
    doubtful_words = [*find_overdue(due_by_name, today), *find_doubtful_dates(station.standards, today)]
    due_by_name |= {standard.role: standard.due for standard in station.standards}
    if doubtful_words:
        is_late = any(past_due(due, today) for due in due_by_name.values())
        remedy = "have it calibrated and give the new dates in the station file" if is_late else CORRECT_DATE
        return Finding(False, ", ".join(doubtful_words), remedy)
    if not due_by_name:
        return Finding(True, "no instrument states a calibration_due")
    return Finding(True, f"no instrument is due before {min(due_by_name.values())}")


def files_released(asked: Asked) -> Finding:
    """Look for files whose content nobody released, or whose release was withdrawn."""
    files = list_files(asked.configuration)
    releases = None if asked.store is None else asked.store.releases
    latest = {file: None if releases is None else releases.read_latest(file.kind, file.sha256) for file in files}
    unreleased = [file for file, release in latest.items() if release is None or release.action != "released"]
    if not unreleased:
        return Finding(True, f"all {len(files)} files are released")
    unreleased_words = ", ".join(
        f"{file.kind} {file.name} ({_state(asked.store, file)}, SHA-256 {file.sha256[:12]})" for file in unreleased
    )
    names = {_name_file(file) for file in unreleased}
    command = f"cbsr-qa release {names.pop() if len(names) == 1 else 'FILE'} --by NAME --why TEXT"
    where = f" (a batch's model is {', '.join(sorted(names - {'FILE'}))})" if names - {"FILE"} else ""
    return Finding(False, unreleased_words, f"have each released{where}", command)


def _name_file(file: FileContent) -> str:
    """The file of a batch's model where ``batch model`` has written it; ``FILE`` for others, which lie anywhere."""
    path = batch_file(file.name, file.sha256)
    return str(path) if file.kind == BATCH_NOUN and path.exists() else "FILE"


def _state(store: Repository | None, file: FileContent) -> str:
    latest = None if store is None else store.releases.read_latest(file.kind, file.sha256)
    if latest is not None:
        return f"withdrawn by {latest.by}"
    unread = () if store is None else store.releases.name_unread(file.kind, file.sha256)
    return "; ".join(["not released", *unread])


def backlog_sent(asked: Asked) -> Finding:
    """Compare the age of the oldest item that the central database has not confirmed with the station's limit."""
    limit_h = asked.configuration.station.sync.backlog_hours
    if limit_h is None:
        return Finding(None, "the station states no backlog_hours in [sync]")
    if asked.store is None:
        return Finding(True, "nothing waits")
    backlog = asked.store.read_backlog()
    clause = f"{backlog.words}; the station allows {limit_h:g} h"
    if not backlog.late(limit_h) and not backlog.unread:
        return Finding(True, clause)
    return Finding(False, clause, "send it to the central database", "cbsr-qa db sync")
