"""How far in time a run, or one phase of it, has been stored."""

from collections.abc import Iterator

from sqlalchemy import Connection, func, select

from cbsr_qa.store.arrays import unpacked
from cbsr_qa.store.run_tables import (
    FrameBlockRow,
    LoadRow,
    PhaseRow,
    RunStateRow,
    SampleBlockRow,
    StepRow,
    UnloadedMarkRow,
)

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
    found: list[float | None] = [*_last_samples_s(connection, run, phase)]
    for table, column in _TIMES:
        query = select(func.max(column)).where(table.run == run)
        if phase is not None:
            query = query.where(table.phase == phase)
        found.append(connection.scalar(query))
    if phase is None:
        found.append(connection.scalar(select(func.max(RunStateRow.time_s)).where(RunStateRow.run == run)))
    return max((float(time_s) for time_s in found if time_s is not None), default=0.0)


def _last_samples_s(connection: Connection, run: str, phase: int | None) -> Iterator[float]:
    """Time of the last sample of each channel in each phase; a rest without frames stores nothing else."""
    of_run = select(SampleBlockRow.phase, SampleBlockRow.channel, func.max(SampleBlockRow.block).label("block"))
    of_run = of_run.where(SampleBlockRow.run == run).group_by(SampleBlockRow.phase, SampleBlockRow.channel)
    if phase is not None:
        of_run = of_run.where(SampleBlockRow.phase == phase)
    last = of_run.subquery()
    query = select(SampleBlockRow.time_s, SampleBlockRow.samples).join(
        last, (SampleBlockRow.phase == last.c.phase) & (SampleBlockRow.block == last.c.block)
    )
    for packed, samples in connection.execute(query.where(SampleBlockRow.run == run)):
        yield float(unpacked(packed, (samples,))[-1])
