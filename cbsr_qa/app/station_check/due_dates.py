"""Calibration dates of instruments and reference standards, compared with today."""

from collections.abc import Iterator
from dataclasses import replace
from datetime import date

from cbsr_qa.app.gate.station_state import CORRECT_DATE
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy
from cbsr_qa.domain.plan.plan import Station
from cbsr_qa.domain.plan.standards import is_dated_later, name_unstated, past_due
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult


def check_standards(station: Station, today: date) -> Iterator[CheckResult]:
    """Yield a line for each reference standard of a station, and one for what is not stated."""
    for standard in station.standards:
        line = check_due(f"standards.{standard.role}", standard.due, station, today)
        line = replace(line, said=f"{standard.all_words()}{line.said.removeprefix(f'due on {standard.due}')}")
        if is_dated_later(standard.date, today):
            outcome, policy = _judge_date(station, is_wrong=True)
            said = f"{standard.all_words()}; dated {standard.date}, later than today, {today}; {policy}"
            line = replace(line, outcome=outcome, said=said, remedy=CORRECT_DATE)
        yield line
    unstated = ", ".join(name_unstated(station.standards))
    if unstated:
        said = f"not stated: {unstated}"
        remedy = "state their certificates in [standards] of the station file"
        yield CheckResult("certificates", CheckOutcome.NOT_DONE, said=said, remedy=remedy, subject="standards")


def check_due(subject: str, due: str, station: Station, today: date) -> CheckResult:
    """Compare a calibration date of the station file with today."""
    days = (date.fromisoformat(due) - today).days
    is_late = past_due(due, today)
    outcome, policy = _judge_date(station, is_wrong=is_late)
    return CheckResult(
        "calibration due",
        outcome,
        value=float(days),
        unit="d",
        allowed="0 or more days left",
        said=f"due on {due}" + (f"; {policy}" if is_late else ""),
        remedy="have it calibrated and give the new date in the station file" if is_late else "",
        subject=subject,
    )


def _judge_date(station: Station, *, is_wrong: bool) -> tuple[CheckOutcome, str]:
    """Return the outcome of a date, and what a wrong one means for runs, in words."""
    if not is_wrong:
        return CheckOutcome.OK, ""
    if station.gate.policy(GateCheck.CALIBRATION_DUE) is GatePolicy.REFUSE:
        return CheckOutcome.FAILED, "runs are refused"
    return CheckOutcome.WARNING, "runs carry a warning"
