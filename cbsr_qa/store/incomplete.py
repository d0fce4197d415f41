"""Runs that were begun and not ended: what a power cut leaves behind."""

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Engine, func, select

from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.store.engine import reading
from cbsr_qa.store.run_tables import (
    FrameBlockRow,
    LoadRow,
    PhaseRow,
    RunRow,
    RunStateRow,
    SampleBlockRow,
    SensorRow,
    StepRow,
)


@dataclass(frozen=True, slots=True)
class IncompleteRun:
    """A run that is under way, or was cut off.

    Parameters
    ----------
    phase : name of the phase it stands in; empty before the first.
    next : what would be done next, in words: the press that was not finished, or the step under way.
    """

    run: str
    serial: str
    phase: str
    next: str


def incomplete_runs(engine: Engine) -> tuple[IncompleteRun, ...]:
    """Return every run whose last state is "running", oldest first."""
    last = select(RunStateRow.run, func.max(RunStateRow.number).label("number")).group_by(RunStateRow.run).subquery()
    running = (
        select(RunRow.run, RunRow.serial)
        .join(RunStateRow, RunStateRow.run == RunRow.run)
        .join(last, (last.c.run == RunStateRow.run) & (last.c.number == RunStateRow.number))
        .where(RunStateRow.end == str(EndReason.RUNNING))
        .order_by(RunRow.run)
    )
    with reading(engine) as connection:
        rows = connection.execute(running).all()
        return tuple(IncompleteRun(row.run, row.serial, *_stands(connection, row.run)) for row in rows)


def counts(engine: Engine) -> dict[str, int]:
    """Return how much is stored."""
    counted = {
        "sensors": select(func.count()).select_from(SensorRow),
        "runs": select(func.count()).select_from(RunRow),
        "frames": select(func.coalesce(func.sum(FrameBlockRow.frames), 0)),
        "samples": select(func.coalesce(func.sum(SampleBlockRow.samples), 0)),
        "loads": select(func.count()).select_from(LoadRow),
    }
    with reading(engine) as connection:
        return {name: int(connection.scalar(query) or 0) for name, query in counted.items()}


def _stands(connection: Connection, run: str) -> tuple[str, str]:
    phases = select(PhaseRow.phase, PhaseRow.name).where(PhaseRow.run == run, PhaseRow.ended_s.is_(None))
    phase = connection.execute(phases.order_by(PhaseRow.phase).limit(1)).one_or_none()
    if phase is None:
        return "", "the next phase"
    steps = select(StepRow.step).where(StepRow.run == run, StepRow.phase == phase.phase, StepRow.attempt == 0)
    begun = connection.scalars(steps.order_by(StepRow.entry)).all()
    finished = connection.scalar(select(func.count()).where(LoadRow.run == run, LoadRow.phase == phase.phase))
    presses = [step for step in begun if step["step"] == "Press"]
    if len(presses) > (finished or 0):
        return phase.name, _words(presses[-1])
    return phase.name, _words(begun[-1]) if begun else "its first step"


def _words(step: dict[str, Any]) -> str:
    match step:
        case {"step": "Press", "load": {"label": label, "x_mm": x, "y_mm": y, "strain": strain, "trial": trial}}:
            return f"press {label} at ({x:g}, {y:g}) mm to {100 * strain:g} %, trial {trial + 1}"
        case {"step": "Ease", "strain": strain}:
            return f"ease to {100 * strain:g} %"
        case {"step": "Hold", "hold_s": hold_s}:
            return f"hold for {hold_s:g} s"
        case {"step": "FindSurface", "x_mm": x, "y_mm": y}:
            return f"find the surface at ({x:g}, {y:g}) mm"
        case {"step": "AcquireFrames", "count": count}:
            return f"take {count} frames"
        case _:
            kind = str(step["step"])
            return {"Home": "home", "Release": "release", "MarkUnloaded": "mark the sheet as rested"}.get(kind, kind)
