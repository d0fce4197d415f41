"""The station: its latest golden sensor, and its control charts."""

from datetime import timedelta
from typing import Final

from cbsr_qa.app.gate.request import Asked, Finding
from cbsr_qa.domain.run import CheckOutcome, CheckResult, StationCheck, worst_check
from cbsr_qa.studies.charts import charts_now

#: How far ahead the clock of another computer may be.
_CLOCKS: Final = timedelta(minutes=1)
#: How the subject of a check's lines about the golden sensor begins.
_SUBJECT: Final = "golden sensor"


def golden_measured(asked: Asked) -> Finding:
    """Judge the latest check of the station that measured a golden sensor, by its outcome and age."""
    station = asked.configuration.station.name
    remedy = "measure the golden sensor", f"cbsr-qa station check {station} --golden SERIAL"
    check = None if asked.store is None else asked.store.latest_golden_check(station)
    if asked.store is None or check is None or check.golden_run is None:
        return Finding(False, f"no golden sensor was ever measured on station {station}", *remedy)
    at = f"the golden sensor of {check.checked_at:%Y-%m-%d %H:%M} UTC"
    outcome = worst_check(_golden_lines(check))
    if outcome not in (CheckOutcome.OK, CheckOutcome.WARNING):
        return Finding(False, f"{at} did not pass: {outcome} (check {check.check})", *remedy)
    age, hours = asked.now - check.checked_at, asked.settings.golden_hours
    if age < -_CLOCKS:
        return Finding(False, f"{at} is later than this computer's clock", "set the clock, then measure it again")
    if hours is not None and age > timedelta(hours=hours):
        words = f"{at} was measured {age / timedelta(hours=1):.1f} h ago; the station allows {hours:g} h"
        return Finding(False, words, *remedy)
    most = asked.settings.golden_runs
    if most is not None and asked.store.runs_since(station, check.golden_run, most) >= most:
        return Finding(
            False, f"{at} was measured {most} or more runs ago; the station allows fewer than {most}", *remedy
        )
    return Finding(True, f"{at} passed")


def _golden_lines(check: StationCheck) -> list[CheckResult]:
    return [line for line in check.results if line.subject.startswith(_SUBJECT)]


def charts_in_control(asked: Asked) -> Finding:
    """Whether no chart signals; a station without references is not known to be in control."""
    station = asked.configuration.station.name
    charts = None if asked.store is None else charts_now(asked.store, station)
    if charts is None:
        words = f"station {station} has no control chart with limits"
        return Finding(
            False, words, "set the limits of one", f"cbsr-qa charts --station {station} --reference-runs N"
        )
    if charts.signals:
        words = "; ".join(signal.words() for signal in charts.signals)
        command = f"cbsr-qa station check {station} --golden SERIAL, cbsr-qa charts --station {station}"
        return Finding(False, words, "measure a golden sensor, and look at the charts", command)
    notes = f" ({'; '.join(charts.notes)})" if charts.notes else ""
    return Finding(True, f"none of {charts.charts} control charts signals{notes}")
