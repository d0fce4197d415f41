"""Changes by a re-analysis: values by measurement, and verdicts."""

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
    median, largest : median and largest of new − valid over all pairs, in the unit; the largest by its size. None
        without pairs.
    run, serial : run and serial number where the largest is; empty where nothing changed.
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
    """A run, and a remark on it."""

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
    overridden_to : verdict that a person decided on against the valid one; None without that.
    calibration : calibration that an earlier analysis of the run issued and that is still stored; None without one.
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
        valid_by_place, new_by_place = _index_values(valid), _index_values(new)
        for key in dict.fromkeys((*valid_by_place, *new_by_place)):
            values = self._found.setdefault(key[:2], _Values())
            valid_value, new_value = valid_by_place.get(key), new_by_place.get(key)
            if valid_value is None or new_value is None:
                values.gained += new_value is not None
                values.lost += valid_value is not None
                continue
            values.changes.append(new_value - valid_value)
            if abs(new_value - valid_value) > abs(values.largest):
                values.largest, values.line = new_value - valid_value, line

    def values(self) -> Iterator[ValueChange]:
        """Yield every measurement with its changes, by name."""
        for (key, unit), compared in sorted(self._found.items(), key=lambda item: item[0]):
            changes = np.frombuffer(compared.changes, dtype=np.float64) if compared.changes else np.empty(0)
            if not (len(changes) or compared.gained or compared.lost):
                continue  # neither analysis has a value
            yield ValueChange(
                key.name,
                key.phase,
                key.qualifier,
                unit,
                len(changes),
                int(np.count_nonzero(changes)),
                float(np.median(changes)) if len(changes) else None,
                compared.largest if len(changes) else None,
                "" if compared.line is None else compared.line.run,
                "" if compared.line is None else compared.line.serial,
                compared.gained,
                compared.lost,
            )


_Place = tuple[MetricKey, str, str, int | None, int | None, int]


def _index_values(measurements: Iterable[Measurement]) -> dict[_Place, float | None]:
    """Return values by what they are of; equal ones are counted."""
    count: Counter[tuple[MetricKey, str, str, int | None, int | None]] = Counter()
    value_by_place: dict[_Place, float | None] = {}
    for measurement in measurements:
        key = (
            MetricKey(measurement.name, measurement.phase, measurement.qualifier),
            measurement.unit,
            measurement.location,
            measurement.trial,
            measurement.load,
        )
        value_by_place[*key, count[key]] = measurement.value
        count[key] += 1
    return value_by_place
