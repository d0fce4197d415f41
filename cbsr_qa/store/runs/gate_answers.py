"""Answers of the checks before a run, as rows of its chain."""

from collections.abc import Sequence

from sqlalchemy import Connection, func, select

from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.chain.links import add_rows
from cbsr_qa.store.damage import read_word
from cbsr_qa.store.mapping import convert_row, row_of
from cbsr_qa.store.tables.records import GateAnswerRow
from cbsr_qa.store.tables.runs import RunStateRow


def add_answers(connection: Connection, run: str, answers: Sequence[GateAnswer]) -> None:
    """Store the answers of a session that is about to begin."""
    begun = select(func.count()).where(RunStateRow.run == run, RunStateRow.end == str(EndReason.RUNNING))
    session = connection.scalar(begun)
    rows = [
        row_of(
            GateAnswerRow,
            answer,
            run=run,
            session=session,
            subject=str(answer.check),
            policy=str(answer.policy),
            outcome=str(answer.outcome),
            operator=answer.by,
        )
        for answer in answers
    ]
    add_rows(connection, run, GateAnswerRow, rows)


def answers_of(connection: Connection, run: str) -> tuple[GateAnswer, ...]:
    """Return the answers stored with a run, by session and in the order of the checks."""
    rows = connection.execute(select(*GateAnswerRow.__table__.columns).where(GateAnswerRow.run == run))
    where = f"run {run}"
    answers = [
        convert_row(
            GateAnswer,
            row,
            check=read_word(GateCheck, row.subject, "gate_answers.subject", where),
            policy=read_word(GatePolicy, row.policy, "gate_answers.policy", where),
            outcome=read_word(GateOutcome, row.outcome, "gate_answers.outcome", where),
            by=row.operator,
        )
        for row in rows
    ]
    order = list(GateCheck)
    return tuple(sorted(answers, key=lambda answer: (answer.session, order.index(answer.check))))
