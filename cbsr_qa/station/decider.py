"""Decisions while a run is under way: its record so far, a thread that computes, decisions of earlier sessions."""

import math
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace

from cbsr_qa.domain.readings.frames import join_frames, join_samples
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.run.events import LoadFinished, RunEnded, RunEvent
from cbsr_qa.domain.run.run import PhaseRecord, PressDecided, RunIdentity, RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.decisions import PressDecisions
from cbsr_qa.station.documents import MemoryJournal
from cbsr_qa.station.plan import Plan
from cbsr_qa.store.runs.journal import shift_times


class RunDecider:
    """Decides between the presses of one session of a run.

    Parameters
    ----------
    earlier : what earlier sessions stored; None for a new run.
    ended : indices of phases that ended in them.
    offset_s : start of this session on the run's clock [s].
    """

    def __init__(
        self,
        decisions: PressDecisions,
        plan: Plan,
        *,
        earlier: RunRecord | None = None,
        ended: frozenset[int] = frozenset(),
        offset_s: float = 0.0,
    ) -> None:
        self._decisions, self._plan, self._offset_s = decisions, plan, offset_s
        phases = () if earlier is None else earlier.phases
        kept = (phase if phase.index in ended else _cut_unfinished(phase) for phase in phases)
        self._earlier = tuple(phase for phase in kept if phase is not None)
        stored = () if earlier is None else earlier.decisions
        self._stored = {(decided.phase, decided.pressed): decided for decided in stored}
        self._events: list[RunEvent] = []
        self._decided: Future[tuple[PressDecided, bool]] = Future()

    def follow(self, event: RunEvent) -> None:
        """Take note of an event that is stored."""
        self._events.append(shift_times(event, self._offset_s))

    def begin(self, identity: RunIdentity, phase: int, pressed: int, last: LoadRecord | None) -> None:
        """Begin to decide in another thread, after some presses of a phase.

        Parameters
        ----------
        last : the last of them if its rest has not ended; None if all are among the events.
        """
        decided: Future[tuple[PressDecided, bool]] = Future()
        self._decided = decided
        if (stored := self._stored.get((phase, pressed))) is not None:
            decided.set_result((stored, False))
            return
        ending = [] if last is None else [shift_times(LoadFinished(phase, last), self._offset_s)]
        record = self._record(identity, [*self._events, *ending])

        def compute() -> None:
            try:
                decided.set_result((self._decisions.decide(record, phase, pressed, 0.0), True))
            except BaseException as error:  # noqa: BLE001 - raised where the run waits for it
                decided.set_exception(error)

        threading.Thread(target=compute, name="next press", daemon=True).start()

    def decide(self, time_s: float) -> tuple[PressDecided, bool]:
        """Wait for the decision; return it, and whether it is new: not of an earlier session."""
        decided, new = self._decided.result()
        return replace(decided, time_s=time_s), new

    def _record(self, identity: RunIdentity, events: Sequence[RunEvent]) -> RunRecord:
        journal = MemoryJournal(self._plan)
        for event in events:
            journal(event)
        now = journal.record(identity, RunEnded(EndReason.RUNNING, "", 0.0, ()))
        by_index = {phase.index: phase for phase in self._earlier}
        for phase in now.phases:
            earlier = by_index.get(phase.index)
            by_index[phase.index] = phase if earlier is None else _join_phases(earlier, phase)
        return replace(now, phases=tuple(by_index[index] for index in sorted(by_index)))


def _cut_unfinished(phase: PhaseRecord) -> PhaseRecord | None:
    """Return what counts of a phase that is continued: all up to the end of its last finished press.

    What follows is repeated, as is a phase without a finished press.
    """
    rested_s = max((load.rest_end_s for load in (*phase.loads, *phase.loops)), default=None)
    if rested_s is None:
        return None
    end_s = math.nextafter(rested_s, math.inf)  # data of that very time count
    frames = None if phase.frames is None else phase.frames.select_interval(-math.inf, end_s)
    samples = tuple(block.select_interval(-math.inf, end_s) for block in phase.samples)
    return replace(phase, frames=frames, samples=samples)


def _join_phases(earlier: PhaseRecord, now: PhaseRecord) -> PhaseRecord:
    """Return a phase of which both sessions pressed a part."""
    blocks = [phase.frames for phase in (earlier, now) if phase.frames is not None]
    channels = sorted({block.channel for block in (*earlier.samples, *now.samples)})
    samples = [
        [block for block in (*earlier.samples, *now.samples) if block.channel == channel] for channel in channels
    ]
    return replace(
        earlier,
        ended_s=now.ended_s,
        frames=join_frames(blocks) if blocks else None,
        samples=tuple(map(join_samples, samples)),
        loads=_join_loads(earlier.loads, now.loads),
        loops=_join_loads(earlier.loops, now.loops),
        unloaded_from_s=earlier.unloaded_from_s if now.unloaded_from_s is None else now.unloaded_from_s,
    )


def _join_loads(earlier: Sequence[LoadRecord], now: Sequence[LoadRecord]) -> tuple[LoadRecord, ...]:
    return tuple(sorted((*earlier, *now), key=lambda load: load.index))
