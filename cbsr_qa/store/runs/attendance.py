"""Pauses and prompts as rows, and back."""

from collections.abc import Iterator
from typing import Any

from sqlalchemy import Connection, Row, func, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.run.attendance import AttendanceEvent, PromptAnswered, PromptShown, RunContinued, RunPaused
from cbsr_qa.store.tables.runs import AttendanceRow


def attendance_values(event: AttendanceEvent) -> dict[str, Any]:
    """Return the columns of an event, without the key columns."""
    values = {"prompt": None, "text": "", "picture": "", "by": "", "time_s": event.time_s}
    match event:
        case RunPaused(by=by):
            return {**values, "kind": "paused", "by": by}
        case RunContinued(by=by):
            return {**values, "kind": "continued", "by": by}
        case PromptShown(prompt=prompt, text=text, picture=picture):
            return {**values, "kind": "shown", "prompt": prompt, "text": text, "picture": picture}
        case PromptAnswered(prompt=prompt, answer=answer, by=by):
            return {**values, "kind": "answered", "prompt": prompt, "text": answer, "by": by}


def attendance_of(connection: Connection, run: str) -> Iterator[AttendanceEvent]:
    """Yield the stored events of a run in their order. StoreError if the kind of one is unknown."""
    table = AttendanceRow
    query = select(*table.__table__.columns).where(table.run == run)
    for row in connection.execute(query.order_by(table.time_s, table.phase, table.entry)):
        yield _event(row)


def count_prompts(connection: Connection, run: str) -> int:
    """Return the number of prompts a run has shown."""
    last = connection.scalar(select(func.max(AttendanceRow.prompt)).where(AttendanceRow.run == run))
    return 0 if last is None else int(last) + 1


def _event(row: Row[Any]) -> AttendanceEvent:
    match row.kind:
        case "paused":
            return RunPaused(row.phase, row.time_s, row.by)
        case "continued":
            return RunContinued(row.phase, row.time_s, row.by)
        case "shown":
            return PromptShown(row.phase, row.prompt, row.text, row.picture, row.time_s)
        case "answered":
            return PromptAnswered(row.phase, row.prompt, row.text, row.by, row.time_s)
    raise StoreError(f"attendance.kind is {str(row.kind)[:32]!r} in phase {row.phase} of run {row.run}")
