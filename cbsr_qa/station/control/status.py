"""What a page that has just been opened needs to know of a run, kept up to date by its events."""

import math
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from cbsr_qa.domain.plan import Press
from cbsr_qa.domain.run import (
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

    Of ``load``, the press under way, and ``next``, which one is next, one is None.
    """

    clock_speed: float | None
    _facts: dict[str, Any] = field(
        default_factory=lambda: {
            "run": None,
            "phase": None,
            "phases": 0,
            "step": "opening the bench",
            "load": None,
            "next": None,
            "remaining_s": None,
            "time_s": 0.0,
            "force_N": None,
            "ended": None,
        }
    )
    _keys: list[LoadKey] = field(default_factory=list)
    _loads: list[dict[str, Any]] = field(default_factory=list)
    _names: dict[int, str] = field(default_factory=dict)
    _warnings: list[str] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def plan(
        self, phases: Mapping[int, str], presses: Iterable[tuple[LoadKey, Press]], done: frozenset[LoadKey]
    ) -> None:
        """State what will be pressed, and what an earlier session has done."""
        with self._lock:
            self._names, self._keys, self._loads = dict(phases), [], []
            self._facts["phases"] = len(phases)
            for key, press in presses:
                load = press.load
                place = {"label": load.label, "x_mm": load.x_mm, "y_mm": load.y_mm}
                entry = {"phase": self._names[key[0]], **place, "strain": load.strain, "trial": load.trial}
                self._keys.append(key)
                self._loads.append({**entry, "done": key in done})
            self._facts["next"] = self._next()

    def doing(self, what: str) -> None:
        """State what is done outside of the plan, e.g. that the result is computed."""
        with self._lock:
            self._facts |= {"step": what, "load": None, "next": None}

    def warn(self, text: str) -> None:
        with self._lock:
            if len(self._warnings) < _MOST_WARNINGS:
                self._warnings.append(text)

    def __call__(self, event: RunEvent) -> None:
        with self._lock:
            self._follow(event)

    def document(self) -> dict[str, Any]:
        """Return the state as JSON."""
        with self._lock:
            return {
                **self._facts,
                "clock_speed": self.clock_speed,
                "loads": [dict(load) for load in self._loads[:MOST_LOADS]],
                "warnings": list(self._warnings),
            }

    def facts(self) -> dict[str, Any]:
        """Return the state without the list of loads and the warnings."""
        with self._lock:
            return dict(self._facts)

    def _follow(self, event: RunEvent) -> None:
        match event:
            case RunStarted(identity=identity):
                self._facts["run"] = identity.run
            case PhaseStarted(name=name):
                self._facts["phase"] = name
            case StepStarted():
                self._step(event)
            case SamplesTaken(samples=samples) if samples.channel == FORCE_CHANNEL and len(samples):
                force_N = float(samples.values[-1])
                self._facts |= {
                    "force_N": force_N if math.isfinite(force_N) else None,
                    "time_s": float(samples.time_s[-1]),
                }
            case LoadFinished(phase=phase, record=record):
                self._finished((phase, record.index))
            case StepRetried(attempt=attempt, why=why) if len(self._warnings) < _MOST_WARNINGS:
                self._warnings.append(f"attempt {attempt} failed, retrying: {why}")
            case RunEnded(end=end, detail=detail):
                self._facts |= {
                    "ended": {"end": str(end), "detail": detail},
                    "load": None,
                    "next": None,
                    "remaining_s": 0.0,
                }

    def _step(self, event: StepStarted) -> None:
        self._facts |= {
            "phase": self._names.get(event.phase, self._facts["phase"]),
            "step": describe(event.step),
            "time_s": event.time_s,
            "remaining_s": event.remaining_s,
        }
        if isinstance(event.step, Press):
            self._facts |= {"load": self._pressed(event), "next": None}

    def _pressed(self, event: StepStarted) -> dict[str, Any] | None:
        """Name the load that begins: the first of its phase with this place, strain and trial that is not done."""
        assert isinstance(event.step, Press)
        load, of = event.step.load, len(self._keys)
        place = {"label": load.label, "x_mm": load.x_mm, "y_mm": load.y_mm}
        wanted = {**place, "strain": load.strain, "trial": load.trial, "done": False}
        for number, (key, entry) in enumerate(zip(self._keys, self._loads, strict=True)):
            if key[0] == event.phase and all(entry[name] == value for name, value in wanted.items()):
                return {**entry, "number": number + 1, "of": of}
        return {**wanted, "number": of, "of": of}

    def _finished(self, key: LoadKey) -> None:
        if key in self._keys:
            self._loads[self._keys.index(key)]["done"] = True
        self._facts |= {"load": None, "next": self._next()}

    def _next(self) -> dict[str, int] | None:
        """Return which press is the first that is not done; None if all are."""
        of = len(self._loads)
        left = (number + 1 for number, load in enumerate(self._loads) if not load["done"])
        return next(({"number": number, "of": of} for number in left), None)
