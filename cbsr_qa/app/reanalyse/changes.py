"""What a re-analysis changes: values by measurement, and verdicts."""

from array import array
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from typing import Self

import numpy as np

from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import MetricKey, RunLine
from cbsr_qa.domain.results.measurement import Measurement


@dataclass(frozen=True, slots=True)
class ValueChange:
    """How one measurement changed over all runs.

    Parameters
    ----------
    values : pairs of values, the valid one and the new one.
    changed : pairs that differ.
    median, largest : of new − valid over all pairs, in the unit; the largest by its size. None without pairs.
    run, serial : where the largest is; empty where nothing changed.
    gained, lost : values that only the new analysis has, and that only the valid one has.
    """

    name: str
    phase: str
    qualifier: str
    unit: str
    values: int
    changed: int
    median: float | None
    largest: float | None
    run: str
    serial: str
    gained: int
    lost: int


@dataclass(frozen=True, slots=True)
class NamedRun:
    """A run, and what is said of it."""

    run: str
    serial: str
    started_at: datetime
    station: str
    why: str

    @classmethod
    def from_line(cls, line: RunLine, why: str) -> Self:
        return fill_from_object(cls, line, why=why)


@dataclass(frozen=True, slots=True)
class Flip:
    """A verdict that differs from the valid one.

    Parameters
    ----------
    was, now, reason : outcome of the valid analysis (None: there was none) and of the new one, with its reason.
    overridden_to : what a person decided against the valid verdict; None without that.
    calibration : that an earlier analysis of the run issued and that is still stored; None without one.
    """

    run: str
    serial: str
    started_at: datetime
    station: str
    was: Outcome | None
    now: Outcome
    reason: str
    overridden_to: Outcome | None
    calibration: str | None


@dataclass(slots=True)
class _Values:
    """Changes of one measurement so far."""

    changes: "array[float]" = field(default_factory=lambda: array("d"))
    gained: int = 0
    lost: int = 0
    largest: float = 0.0
    line: RunLine | None = None


class Changes:
    """Collects what changed, run by run: one number a pair of values is kept."""

    def __init__(self) -> None:
        self._found: dict[tuple[MetricKey, str], _Values] = {}

    def add(self, line: RunLine, valid: Iterable[Measurement], new: Iterable[Measurement]) -> None:
        """Add a run's values of both analyses."""
        before, after = _index_values(valid), _index_values(new)
        for key in dict.fromkeys((*before, *after)):
            values = self._found.setdefault(key[:2], _Values())
            was, now = before.get(key), after.get(key)
            if was is None or now is None:
                values.gained += now is not None
                values.lost += was is not None
                continue
            values.changes.append(now - was)
            if abs(now - was) > abs(values.largest):
                values.largest, values.line = now - was, line

    def values(self) -> Iterator[ValueChange]:
        """Yield every measurement with its changes, by name."""
        for (key, unit), found in sorted(self._found.items(), key=lambda item: item[0]):
            changes = np.frombuffer(found.changes, dtype=np.float64) if found.changes else np.empty(0)
            if not (len(changes) or found.gained or found.lost):
                continue  # neither analysis has a value
            yield ValueChange(
                key.name,
                key.phase,
                key.qualifier,
                unit,
                len(changes),
                int(np.count_nonzero(changes)),
                float(np.median(changes)) if len(changes) else None,
                found.largest if len(changes) else None,
                "" if found.line is None else found.line.run,
                "" if found.line is None else found.line.serial,
                found.gained,
                found.lost,
            )


_Place = tuple[MetricKey, str, str, int | None, int | None, int]


def _index_values(measurements: Iterable[Measurement]) -> dict[_Place, float | None]:
    """Return values by what they are of; equal ones are counted."""
    count: Counter[tuple[MetricKey, str, str, int | None, int | None]] = Counter()
    found: dict[_Place, float | None] = {}
    for one in measurements:
        key = (MetricKey(one.name, one.phase, one.qualifier), one.unit, one.location, one.trial, one.load)
        found[*key, count[key]] = one.value
        count[key] += 1
    return found
