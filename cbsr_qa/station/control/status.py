"""What a page that has just been opened needs to know of a run, kept up to date by its events."""

import math
import threading
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from cbsr_qa.domain.plan.steps import Press
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.events import (
    LoadFinished,
    PhaseStarted,
    RunEnded,
    RunEvent,
    RunStarted,
    SamplesTaken,
    StepRetried,
    StepStarted,
)
from cbsr_qa.station.bench import FORCE_CHANNEL
from cbsr_qa.station.control.messages import Activity, Ended, LoadUnderWay, Numbered, PlannedLoad
from cbsr_qa.station.plan import LoadKey, describe

#: No more planned loads are listed: their number is stated in any case.
MOST_LOADS: Final = 2000
#: Nor more warnings.
_MOST_WARNINGS: Final = 100


@dataclass(slots=True)
class RunStatus:
    """A subscriber that tracks the state of a run for other threads.

    Parameters
    ----------
    clock_speed : station seconds per second; None if the clock does not wait.
    """

    clock_speed: float | None
    _now: Activity = field(default_factory=Activity)
    _keys: list[LoadKey] = field(default_factory=list)
    _loads: list[PlannedLoad] = field(default_factory=list)
    _most: int | None = None
    _begun: int = 0
    _names: dict[int, str] = field(default_factory=dict)
    _warnings: list[str] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def plan(
        self,
        phases: Mapping[int, str],
        presses: Iterable[tuple[LoadKey, Press]],
        done: Collection[LoadKey],
        most: int | None = None,
    ) -> None:
        """State what will be pressed, and what an earlier session has done.

        ``most``: most presses that will be made, if phases choose among those listed.
        """
        with self._lock:
            self._names, self._keys, self._loads = dict(phases), [], []
            for key, press in presses:
                self._keys.append(key)
                self._loads.append(_plan_load(self._names[key[0]], press.load, done=key in done))
            self._most, self._begun = most, len(done)
            self._set(phases=len(phases), next=self._find_next())

    def doing(self, what: str) -> None:
        """State what is done outside of the plan, e.g. that the result is computed."""
        with self._lock:
            self._set(step=what, load=None, next=None)

    def warn(self, text: str) -> None:
        with self._lock:
            self._warn(text)

    def __call__(self, event: RunEvent) -> None:
        with self._lock:
            self._follow(event)

    def now(self) -> Activity:
        """Return the state without the list of loads and the warnings."""
        with self._lock:
            return self._now

    def whole(self) -> Activity:
        """Return the state."""
        with self._lock:
            return replace(
                self._now,
                clock_speed=self.clock_speed,
                loads=tuple(self._loads[:MOST_LOADS]),
                warnings=tuple(self._warnings),
            )

    def _set(self, **values: Any) -> None:
        self._now = replace(self._now, **values)

    def _warn(self, text: str) -> None:
        if len(self._warnings) < _MOST_WARNINGS:
            self._warnings.append(text)

    def _follow(self, event: RunEvent) -> None:
        match event:
            case RunStarted(identity=identity):
                self._set(run=identity.run)
            case PhaseStarted(name=name):
                self._set(phase=name)
            case StepStarted():
                self._step(event)
            case SamplesTaken(samples=samples) if samples.channel == FORCE_CHANNEL and len(samples):
                force_N = float(samples.values[-1])
                self._set(force_N=force_N if math.isfinite(force_N) else None, time_s=float(samples.time_s[-1]))
            case LoadFinished(phase=phase, record=record):
                key = (phase, record.index)
                if key in self._keys:
                    number = self._keys.index(key)
                    self._loads[number] = replace(self._loads[number], done=True)
                self._set(load=None, next=self._find_next())
            case StepRetried(attempt=attempt, why=why):
                self._warn(f"attempt {attempt} failed, retrying: {why}")
            case RunEnded(end=end, detail=detail):
                self._set(ended=Ended(end, detail), load=None, next=None, remaining_s=0.0)

    def _step(self, event: StepStarted) -> None:
        self._set(
            phase=self._names.get(event.phase, self._now.phase),
            step=describe(event.step),
            time_s=event.time_s,
            remaining_s=event.remaining_s,
        )
        if isinstance(event.step, Press):
            # The first of its phase with this place, strain and trial that is not done.
            wanted = _plan_load(self._names.get(event.phase, ""), event.step.load, done=False)
            numbers = (n for n, key in enumerate(self._keys) if key[0] == event.phase and self._loads[n] == wanted)
            self._begun += 1
            of = len(self._loads)
            number = 1 + next(numbers, of - 1) if self._most is None else self._begun
            load = LoadUnderWay(number=number, of=self._most or of, **vars(wanted))
            self._set(load=load, next=None)

    def _find_next(self) -> Numbered | None:
        """Return which press is the first that is not done; None if all are, or it is still to be decided."""
        if self._most is not None:
            return None
        left = (number for number, load in enumerate(self._loads, start=1) if not load.done)
        return next((Numbered(number, len(self._loads)) for number in left), None)


def _plan_load(phase: str, load: Load, *, done: bool) -> PlannedLoad:
    return PlannedLoad(phase, load.label, load.x_mm, load.y_mm, load.strain, load.trial, done)
