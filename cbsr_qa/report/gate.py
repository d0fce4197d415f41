"""Texts of reports about the checks before a run."""

from collections.abc import Iterable, Sequence
from typing import Final

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.report import Block, Cell, Paragraph, Table
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome
from cbsr_qa.report.tables import plural, text_table

_CELLS: Final = {
    GateOutcome.PASSED: Outcome.PASS,
    GateOutcome.WARNED: Outcome.MARGINAL,
    GateOutcome.OVERRIDDEN: Outcome.MARGINAL,
    GateOutcome.REFUSED: Outcome.FAIL,
    GateOutcome.OFF: Outcome.NOT_JUDGED,
}
_NOTED: Final = (GateOutcome.WARNED, GateOutcome.OVERRIDDEN, GateOutcome.REFUSED)


def gate_table(caption: str, answers: Iterable[GateAnswer]) -> Table:
    """Return answers of the gate, one a row."""
    rows = [
        (str(answer.check), str(answer.policy), Cell(str(answer.outcome), _CELLS[answer.outcome]), answer.sentence)
        for answer in answers
    ]
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
