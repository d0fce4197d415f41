"""How far in time a run, or one phase of it, has been stored."""

from sqlalchemy import Connection, func, select

from cbsr_qa.store.run_tables import FrameBlockRow, LoadRow, PhaseRow, RunStateRow, StepRow, UnloadedMarkRow

#: Columns that hold a time on the run's clock [s], of tables with a phase.
_TIMES = (
    (FrameBlockRow, FrameBlockRow.last_s),
    (StepRow, StepRow.time_s),
    (LoadRow, LoadRow.rest_end_s),
    (UnloadedMarkRow, UnloadedMarkRow.time_s),
    (PhaseRow, PhaseRow.started_s),
    (PhaseRow, PhaseRow.ended_s),
)


def last_time_s(connection: Connection, run: str, phase: int | None = None) -> float:
    """Return the last time stored of a run, or of one phase; 0 where nothing is stored [s]."""
    found = []
    for table, column in _TIMES:
        query = select(func.max(column)).where(table.run == run)
        if phase is not None:
            query = query.where(table.phase == phase)
        found.append(connection.scalar(query))
    if phase is None:
        found.append(connection.scalar(select(func.max(RunStateRow.time_s)).where(RunStateRow.run == run)))
    return max((float(time_s) for time_s in found if time_s is not None), default=0.0)
