"""Sessions of a run, and what of each counts: a load that was cut off and pressed again is evidence, no more."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Row, select

from cbsr_qa.domain.loads import LoadRecord
from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.domain.run import RunSession
from cbsr_qa.store.failures import stored
from cbsr_qa.store.run_tables import PhaseRow, RunStateRow, StepRow

#: (from, to) on the run's time line [s]; what is from the very beginning belongs to the session before.
Span = tuple[float, float]


def sessions_of(connection: Connection, run: str) -> tuple[RunSession, ...]:
    """Return the sessions of a run in order."""
    states = select(*RunStateRow.__table__.columns).where(RunStateRow.run == run).order_by(RunStateRow.number)
    found: list[RunSession] = []
    begun = None
    for row in connection.execute(states):
        if row.end == EndReason.RUNNING:
            begun = row
            found.append(_session(row, row))
        elif begun is not None:
            found[-1] = _session(begun, row)
    return tuple(found)


def counted_spans(
    connection: Connection, phase: PhaseRow, sessions: Sequence[RunSession], loads: Sequence[LoadRecord]
) -> list[Span]:
    """Return the spans of time whose frames and samples count for a phase.

    In the last session that worked on it everything counts. In an earlier one it is what was taken up to the end of
    its last finished load: the press that was cut off after it was repeated, and so was the set-up of a session that
    finished none. What a later session did to set the bench up again, after the phase had ended, does not count.
    """
    steps = select(StepRow.time_s).where(StepRow.run == phase.run, StepRow.phase == phase.phase, StepRow.attempt == 0)
    times_s = np.array(connection.scalars(steps).all(), dtype=np.float64)
    ends_s = float("inf") if phase.ended_s is None else phase.ended_s
    starts_s = [float("-inf"), *(session.started_s for session in sessions[1:])]
    spans = [
        span
        for span in zip(starts_s, [*starts_s[1:], float("inf")], strict=True)
        if span[0] < ends_s and ((times_s >= span[0]) & (times_s < span[1])).any()
    ]
    counted = []
    for from_s, to_s in spans[:-1]:
        rested_s = [load.rest_end_s for load in loads if from_s <= load.press_start_s < to_s]
        if rested_s:
            counted.append((from_s, max(rested_s)))
    return counted + [(from_s, ends_s) for from_s, _ in spans[-1:]]


def within(time_s: NDArray[np.float64], spans: Sequence[Span]) -> NDArray[np.bool_]:
    """Return which times (n,) lie in some spans, (n,) bool."""
    inside = np.zeros(len(time_s), dtype=np.bool_)
    for from_s, to_s in spans:
        inside |= (time_s > from_s) & (time_s <= to_s)
    return inside


def _session(begun: Row[Any], last: Row[Any]) -> RunSession:
    return RunSession(
        started_s=begun.time_s,
        ended_s=None if last is begun else last.time_s,
        end=stored(EndReason, last.end, "run_states.end", f"run {last.run}, state {last.number},"),
        detail=last.detail,
        operator=begun.operator or "",
        software=tuple((name, version) for name, version in begun.software or ()),
        noted_at=begun.noted_at,
    )
