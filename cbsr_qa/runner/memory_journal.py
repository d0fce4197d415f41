"""A run that is kept in memory only: for simulations that are priced and forgotten."""

from typing import TypeVar

from cbsr_qa.domain.frames import join_frames, join_samples
from cbsr_qa.domain.run import PhaseRecord, RunIdentity, RunRecord
from cbsr_qa.domain.run_events import (
    FramesTaken,
    LoadFinished,
    PhaseFinished,
    PhaseStarted,
    RunEnded,
    RunEvent,
    SamplesTaken,
    Unloaded,
)
from cbsr_qa.runner.plan import Plan

E = TypeVar("E", FramesTaken, LoadFinished, SamplesTaken, Unloaded)


class MemoryJournal:
    """Keeps the documents of a run and puts them together as a record.

    Parameters
    ----------
    plan : that is run.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._events: list[RunEvent] = []

    def __call__(self, event: RunEvent) -> None:
        """Keep one document."""
        self._events.append(event)

    def record(self, identity: RunIdentity, ended: RunEnded) -> RunRecord:
        """Return the run as the database would give it back, but for its sessions."""
        ends = {event.index: event.time_s for event in self._events if isinstance(event, PhaseFinished)}
        started = [event for event in self._events if isinstance(event, PhaseStarted)]
        phases = tuple(self._phase(event, ends.get(event.index, ended.time_s)) for event in started)
        plan = self._plan
        return RunRecord(
            identity, plan.sensor_type, plan.material, plan.indenter, phases, ended.end, ended.detail, ended.time_s,
            ended.spent,
        )  # fmt: skip

    def _of(self, kind: type[E], phase: int) -> list[E]:
        return [event for event in self._events if isinstance(event, kind) and event.phase == phase]

    def _phase(self, event: PhaseStarted, ended_s: float) -> PhaseRecord:
        frames = [one.frames for one in self._of(FramesTaken, event.index)]
        samples = [one.samples for one in self._of(SamplesTaken, event.index)]
        channels = sorted({block.channel for block in samples})
        loads = [one.record for one in self._of(LoadFinished, event.index)]
        return PhaseRecord(
            index=event.index,
            name=event.name,
            sequence=event.sequence,
            started_s=event.time_s,
            ended_s=ended_s,
            frames=join_frames(frames) if frames else None,
            samples=tuple(join_samples([one for one in samples if one.channel == name]) for name in channels),
            loads=tuple(load for load in loads if not load.eased),
            loops=tuple(load for load in loads if load.eased),
            unloaded_from_s=max((one.time_s for one in self._of(Unloaded, event.index)), default=None),
            role=event.role,
        )
