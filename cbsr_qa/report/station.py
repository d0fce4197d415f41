"""Texts of reports and pages about a station: its checks before a run, its latest own check, its control charts."""

from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import Final

from cbsr_qa.domain.numbers import prefix_kind
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.charts import StationCharts
from cbsr_qa.domain.results.report import Block, Cell, Paragraph, Table
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, StationCheck
from cbsr_qa.report.tables import plural, quantity, text_table
from cbsr_qa.system.clock import write_local_time

_CELLS: Final = {
    CheckOutcome.OK: Outcome.PASS,
    CheckOutcome.WARNING: Outcome.MARGINAL,
    CheckOutcome.FAILED: Outcome.FAIL,
    CheckOutcome.NOT_DONE: Outcome.NOT_JUDGED,
}
_COLUMNS: Final = ("Part", "Check", "Value", "Allowed", "Details", "Outcome")


def lines_table(caption: str, results: Sequence[CheckResult]) -> Table:
    """Return results of a check, one a row."""
    rows = []
    for line in results:
        value = "–" if line.value is None else quantity(line.value, line.unit)
        outcome = Cell(str(line.outcome), _CELLS[line.outcome])
        rows.append((line.subject, line.name, value, line.allowed or "–", line.said or "–", outcome))
    return text_table(caption, _COLUMNS, rows, (2,))


def remedies(results: Sequence[CheckResult]) -> tuple[Paragraph, ...]:
    """Return what to do about what failed or warns, a paragraph each."""
    paragraphs = []
    for line in results:
        if line.outcome in (CheckOutcome.FAILED, CheckOutcome.WARNING):
            tone = "warning" if line.outcome is CheckOutcome.FAILED else "note"
            finding = f"{line.subject}, {line.name}: {line.outcome}"
            paragraphs.append(
                Paragraph(f"{finding}. What to do: {line.remedy}." if line.remedy else f"{finding}.", tone)
            )
    return tuple(paragraphs)


def count_results(check: StationCheck) -> str:
    """Say how many results failed and warn: ``2 failed, 1 warning``; ``none failed``."""
    failed, warned = len(check.lines(CheckOutcome.FAILED)), len(check.lines(CheckOutcome.WARNING))
    counts = f"{failed or 'none'} failed"
    return f"{counts}, {plural(warned, 'warning')}" if warned else counts


def station_blocks(station: str, check: StationCheck | None, begun: datetime) -> tuple[Block, ...]:
    """Say how a station stood when a run began on it: its latest check, how old that was, what failed.

    Parameters
    ----------
    check : the latest until then; None where there was none.
    begun : start of the run.
    """
    if check is None:
        sentence = f"Station {station} had never been checked when this run began: run cbsr-qa station check."
        return (Paragraph(sentence, "note"),)
    by_operator = f" by {check.operator}" if check.operator else ""
    checked_at = write_local_time(check.checked_at)
    sentence = (
        f"Station {station} was last checked {age(check, begun)} before this run began, on {checked_at}{by_operator}"
    )
    tone = {CheckOutcome.FAILED: "warning", CheckOutcome.WARNING: "note"}.get(check.outcome, "plain")
    blocks: list[Block] = [
        Paragraph(f"{sentence}: of {plural(len(check.results), 'check')}, {count_results(check)}.", tone)
    ]
    bad_lines = [line for line in check.results if line.outcome in (CheckOutcome.FAILED, CheckOutcome.WARNING)]
    if bad_lines:
        blocks.append(lines_table("Failed checks and warnings.", bad_lines))
        blocks += remedies(bad_lines)
    full = lines_table(f"All results of check {check.check}.", check.results)
    blocks.append(Table(full.caption, full.columns, full.rows, full.numeric, folded=True))
    return tuple(blocks)


def age(check: StationCheck, at: datetime) -> str:
    """Say how old a check was at a moment: minutes, hours, days."""
    seconds = max((at - check.checked_at).total_seconds(), 0.0)
    if seconds < 5400:
        return plural(round(seconds / 60), "minute") if seconds >= 60 else "less than a minute"
    if seconds < 2 * 86400:
        return plural(round(seconds / 3600), "hour")
    return plural(round(seconds / 86400), "day")


def chart_blocks(charts: StationCharts | None) -> tuple[Block, ...]:
    """Say which charts signal since when and by which rule; nothing where the station has no reference stored."""
    if charts is None:
        return ()
    all_charts = f"{plural(charts.charts, 'control chart')} of {prefix_kind('station', charts.station)}"
    if not charts.signals:
        blocks: list[Block] = [Paragraph(f"None of {all_charts} signals.")]
    else:
        sentence = f"The station is out of control: {len(charts.signals)} of {all_charts} signal."
        blocks = [Paragraph(sentence, "warning")]
        blocks += [Paragraph(f"{signal.words()}.", "warning") for signal in charts.signals]
        blocks.append(
            Paragraph(
                "A signal is about the station, not about this sensor's limits: measure a golden sensor "
                f"(cbsr-qa station check --golden), and see cbsr-qa charts --station {charts.station}.",
                "note",
            )
        )
    return (*blocks, *(Paragraph(f"{note}.", "note") for note in charts.notes))


_GATE_CELLS: Final = {
    GateOutcome.PASSED: Outcome.PASS,
    GateOutcome.WARNED: Outcome.MARGINAL,
    GateOutcome.OVERRIDDEN: Outcome.MARGINAL,
    GateOutcome.REFUSED: Outcome.FAIL,
    GateOutcome.OFF: Outcome.NOT_JUDGED,
}
_NOTED: Final = (GateOutcome.WARNED, GateOutcome.OVERRIDDEN, GateOutcome.REFUSED)


def gate_table(caption: str, answers: Iterable[GateAnswer]) -> Table:
    """Return answers of the gate, one a row."""
    rows = []
    for answer in answers:
        outcome = Cell(str(answer.outcome), _GATE_CELLS[answer.outcome])
        rows.append((str(answer.check), str(answer.policy), outcome, answer.sentence))
    return text_table(caption, ("Check", "Policy", "Outcome", "Finding"), rows)


def gate_words(answers: Sequence[GateAnswer]) -> str:
    """Say which checks did not pass, of how many: ``5 checks; retest overridden: …``; empty if all passed."""
    asked_checks = [answer for answer in answers if answer.outcome is not GateOutcome.OFF]
    noted = [
        f"{answer.check} {answer.outcome}: {answer.sentence}" for answer in asked_checks if answer.outcome in _NOTED
    ]
    return "; ".join([plural(len(asked_checks), "check"), *noted]) if noted else ""


def gate_blocks(answers: Sequence[GateAnswer]) -> tuple[Block, ...]:
    """Show the answers before the run and at each resumption; nothing for a run without answers."""
    if not answers:
        return ()
    blocks: list[Block] = [
        Paragraph(f"Before the run, {answer.check} was {answer.outcome}: {answer.sentence}.", "warning")
        for answer in answers
        if answer.outcome in _NOTED
    ]
    for session in sorted({answer.session for answer in answers}):
        session_answers = [answer for answer in answers if answer.session == session]
        caption = "Checks before the run." if session == 0 else f"Asked again before resumption {session} of the run."
        table = gate_table(caption, session_answers)
        blocks.append(Table(table.caption, table.columns, table.rows, folded=True))
    return tuple(blocks)
