"""Sessions of a run, and which loads count: an interrupted load that was repeated does not.

Also runs that did not finish, because of a power cut, a fault or an operator.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Engine, Row, exists, func, select

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.run.run import RunSession
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.damage import read_word
from cbsr_qa.store.engine import reading
from cbsr_qa.store.locks import writer_of
from cbsr_qa.store.runs.rows import phases_of
from cbsr_qa.store.runs.standing import up_to_date
from cbsr_qa.store.tables.results import AnalysisRow
from cbsr_qa.store.tables.runs import (
    LoadRow,
    PhaseEndRow,
    RunRow,
    RunStateRow,
    StepRow,
)

#: (from, to) on the run's time line [s]; a time exactly at the start belongs to the session before.
Span = tuple[float, float]


def sessions_of(connection: Connection, run: str) -> tuple[RunSession, ...]:
    """Return the sessions of a run in order."""
    states = select(*RunStateRow.__table__.columns).where(RunStateRow.run == run).order_by(RunStateRow.number)
    sessions: list[RunSession] = []
    first_row = None
    for row in connection.execute(states):
        if row.end == EndReason.RUNNING:
            first_row = row
            sessions.append(_session(row, row))
        elif first_row is not None:
            sessions[-1] = _session(first_row, row)
    return tuple(sessions)


def spans_that_count(
    connection: Connection, phase: Row[Any], sessions: Sequence[RunSession], loads: Sequence[LoadRecord]
) -> list[Span]:
    """Return the spans of time whose frames and samples count for a phase.

    Everything in the last session of a phase counts. Of an earlier session, data up to the end of its last finished
    load count: the interrupted press after it was repeated, as was the set-up of a session without a finished load.
    When a later session set the bench up again after the phase had ended, that does not count.
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


def within(time_s: Array, spans: Sequence[Span]) -> NDArray[np.bool_]:
    """Return which times (n,) lie in some spans, (n,) bool."""
    inside = np.zeros(len(time_s), dtype=np.bool_)
    for from_s, to_s in spans:
        inside |= (time_s > from_s) & (time_s <= to_s)
    return inside


def _session(first: Row[Any], last: Row[Any]) -> RunSession:
    return RunSession(
        started_s=first.time_s,
        ended_s=None if last is first else last.time_s,
        end=read_word(EndReason, last.end, "run_states.end", f"run {last.run}, state {last.number},"),
        detail=last.detail,
        operator=first.operator or "",
        software=tuple((name, version) for name, version in first.software or ()),
        noted_at=first.noted_at,
    )


@dataclass(frozen=True, slots=True)
class IncompleteRun:
    """A run that did not finish.

    Parameters
    ----------
    phase : name of the current phase; empty before the first.
    next : next action, in words: the unfinished press, or the current step.
    end, detail : ``"running"`` if in progress or interrupted; ``"aborted"`` or ``"broken"``, and the cause.
    writer : process that is writing it now; may be empty.
    """

    run: str
    serial: str
    phase: str
    next: str
    end: str = str(EndReason.RUNNING)
    detail: str = ""
    writer: str = ""


class UnfinishedRuns:
    """Runs without a result: those that did not finish, and those that were not analysed since."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def list_incomplete(self) -> tuple[IncompleteRun, ...]:
        """Return every run whose last state is not "finished", oldest first."""
        last = (
            select(RunStateRow.run, func.max(RunStateRow.number).label("number")).group_by(RunStateRow.run).subquery()
        )
        unfinished = (
            select(RunRow.run, RunRow.serial, RunStateRow.end, RunStateRow.detail)
            .join(RunStateRow, RunStateRow.run == RunRow.run)
            .join(last, (last.c.run == RunStateRow.run) & (last.c.number == RunStateRow.number))
            .where(RunStateRow.end != str(EndReason.FINISHED))
            .order_by(RunRow.run)
        )
        with reading(self._engine) as connection:
            rows = connection.execute(unfinished).all()
            states = [(row, _stands(connection, row.run)) for row in rows]
        return tuple(
            IncompleteRun(
                row.run,
                row.serial,
                *state,
                read_word(EndReason, row.end, "run_states.end", f"run {row.run}"),
                row.detail,
                writer_of(self._engine, row.run),
            )
            for row, state in states
        )

    def list_without_result(self) -> tuple[tuple[str, str], ...]:
        """Return (run, serial) of finished runs that were not analysed since, oldest first."""
        finished = select(RunStateRow.run).where(RunStateRow.end == str(EndReason.FINISHED))
        query = select(RunRow.run, RunRow.serial).where(
            RunRow.run.in_(finished), ~exists().where(AnalysisRow.run == RunRow.run, up_to_date())
        )
        with reading(self._engine) as connection:
            return tuple((run, serial) for run, serial in connection.execute(query.order_by(RunRow.run)))


def _stands(connection: Connection, run: str) -> tuple[str, str]:
    phase = connection.execute(phases_of(run).where(PhaseEndRow.ended_s.is_(None)).limit(1)).one_or_none()
    if phase is None:
        return "", "the next phase"
    steps = select(StepRow.step, StepRow.time_s).where(
        StepRow.run == run, StepRow.phase == phase.phase, StepRow.attempt == 0
    )
    begun_steps = connection.execute(steps.order_by(StepRow.entry)).all()
    presses = [row for row in begun_steps if row.step["step"] == "Press"]
    last_held = select(func.max(LoadRow.press_start_s)).where(LoadRow.run == run, LoadRow.phase == phase.phase)
    if presses:
        last_held_s = connection.scalar(last_held)
        if last_held_s is None or last_held_s < presses[-1].time_s:  # the last press was not held to its end
            return phase.name, _words(presses[-1].step)
    return phase.name, _words(begun_steps[-1].step) if begun_steps else "its first step"


def _words(step: dict[str, Any]) -> str:
    match step:
        case {"step": "Press", "load": {"label": label, "x_mm": x, "y_mm": y, "strain": strain, "trial": trial}}:
            return f"press {label} at ({x:zg}, {y:zg}) mm to {100 * strain:g} %, trial {trial + 1}"
        case {"step": "Ease", "strain": strain}:
            return f"ease to {100 * strain:g} %"
        case {"step": "Hold" | "Settle", "hold_s": hold_s}:
            return f"hold for {hold_s:g} s"
        case {"step": "FindSurface" | "TouchPlane", "x_mm": x, "y_mm": y}:
            return f"find the surface at ({x:zg}, {y:zg}) mm"
        case {"step": "AcquireFrames", "count": count}:
            return f"take {count} frames"
        case _:
            kind = str(step["step"])
            return {"Home": "home", "Release": "release", "MarkUnloaded": "mark the sheet as rested"}.get(kind, kind)
