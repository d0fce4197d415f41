"""A point of the frontier: a setting, its accuracy relative to known truth, and its cost in time."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final, Literal, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError
from scipy.special import ndtri, stdtrit

from cbsr_qa.domain.errors import NumericsError, StoreError

#: Direction of more accurate values: larger, smaller, or near a stated value (such values are not compared).
Better = Literal["more", "less", "stated"]
#: Setting of a knob: a name, a switch, or a number.
Knob = str | bool | int | float

#: Confidence of intervals of pairs.
_CONFIDENCE: Final = 0.95

T = TypeVar("T")


class TimeBasis(StrEnum):
    """Kind of time."""

    COMPUTER = "computer"  #: seconds of one core
    STATION = "station"  #: seconds a sensor occupies the rig
    PRESSES = "presses"  #: number of presses


@dataclass(frozen=True, slots=True)
class Accuracy:
    """One value of a setting relative to known truth, or its mean over simulated sensors.

    Parameters
    ----------
    stderr : standard error of that mean; None if the value is exact, or from a single sensor.
    better : direction of more accurate values: larger (an overlap), smaller (an error), or near to a stated value.
    by_sensor : values that the mean is of, in the order of the sensors, which are the same for all settings of a
        sweep; empty if the value is exact, or its error has another source.
    """

    value: float
    stderr: float | None
    unit: str
    better: Better = "less"
    by_sensor: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        stderr = self.stderr or 0.0
        if not all(map(math.isfinite, (self.value, stderr, *self.by_sensor))) or stderr < 0:
            raise NumericsError(
                f"an accuracy of {self.value} ± {self.stderr} {self.unit} is not a finite number with an error of it",
                remedy="leave out a value that could not be determined, and say so in the point's note",
            )

    @classmethod
    def from_sensors(cls, values: Sequence[float], unit: str, better: Better = "less") -> "Accuracy":
        """Mean of one value per sensor, with its standard error if there are several."""
        by_sensor = tuple(float(value) for value in values)
        stderr = float(np.std(by_sensor, ddof=1)) / math.sqrt(len(by_sensor)) if len(by_sensor) > 1 else None
        return cls(float(np.mean(by_sensor)), stderr, unit, better, by_sensor)

    def upper_bound(self, confidence: float) -> float | None:
        """Return the value that the true mean is below with a confidence; None from a single sensor.

        By Student's t for a mean over sensors, by the normal distribution for another standard error.
        """
        if len(self.by_sensor) == 1:
            return None
        degrees = len(self.by_sensor) - 1
        factor = float(stdtrit(degrees, confidence) if degrees > 0 else ndtri(confidence))
        return self.value + factor * (self.stderr or 0.0)

    def subtract(self, other: "Accuracy", factor: float = 1.0) -> "Accuracy":
        """Return the difference to another value times a factor: of pairs if both are of the same sensors."""
        if self.by_sensor and len(self.by_sensor) == len(other.by_sensor):
            pairs = zip(self.by_sensor, other.by_sensor, strict=True)
            return Accuracy.from_sensors([own - factor * others for own, others in pairs], self.unit)
        stderr = math.hypot(self.stderr or 0.0, factor * (other.stderr or 0.0))
        return Accuracy(self.value - factor * other.value, stderr, self.unit)

    @property
    def shortfall(self) -> float:
        """The value, signed so that smaller is better."""
        return -self.value if self.better == "more" else self.value


@dataclass(frozen=True, slots=True)
class Point:
    """A tried setting.

    Parameters
    ----------
    series : sweep it belongs to; points are compared within one.
    accuracy : values relative to known truth by name; undetermined ones are absent.
    compute_s : time of the computer [s], of one frame or one solution; None if it was not measured.
    station_s : time a sensor occupies the rig [s]; None for settings of the computer alone.
    seeds : repetitions with other random numbers; 1 without randomness.
    costs : other costs, by name with the unit in it (``setup_s``, ``memory_bytes``, ``unknowns``).
    pareto : whether no other setting dominates it; None before points are compared.
    """

    clock: TimeBasis
    series: str
    knobs: Mapping[str, Knob]
    accuracy: Mapping[str, Accuracy]
    compute_s: float | None = None
    station_s: float | None = None
    seeds: int = 1
    note: str = ""
    costs: Mapping[str, float] = field(default_factory=dict)
    pareto: bool | None = None

    def __post_init__(self) -> None:
        numbers = {"compute_s": self.compute_s, "station_s": self.station_s, **self.costs}
        numbers |= {name: value for name, value in self.knobs.items() if not isinstance(value, str)}
        bad_names = [name for name, value in numbers.items() if value is not None and not math.isfinite(value)]
        if bad_names or self.seeds < 1:
            problem = f"{bad_names[0]} of {numbers[bad_names[0]]}" if bad_names else f"{self.seeds} seeds"
            raise NumericsError(f"a point of series {self.series!r} has {problem}", remedy="give finite numbers")


@dataclass(frozen=True, slots=True)
class BatchChange:
    """What the batch as prior changes about one way, in pairs.

    Parameters
    ----------
    places, hold_s, transients : the way.
    without_N, with_N : mean force error over the sensors, without the batch and with it.
    change_N, low_N, high_N : mean difference of pairs, with its interval of 95 % over the sensors.
    """

    places: int
    hold_s: float
    transients: str
    without_N: float
    with_N: float
    change_N: float
    low_N: float
    high_N: float

    @classmethod
    def from_pair(cls, knobs: Mapping[str, Knob], without: Accuracy, beside: Accuracy) -> "BatchChange":
        """Compare a way with the batch to the same without, on the same sensors."""
        change = beside.subtract(without)
        tail = float(stdtrit(len(change.by_sensor) - 1, (1 + _CONFIDENCE) / 2)) * (change.stderr or 0.0)
        return cls(
            places=int(knobs["places"]),
            hold_s=float(knobs["hold_s"]),
            transients=str(knobs["transients"]),
            without_N=without.value,
            with_N=beside.value,
            change_N=change.value,
            low_N=change.value - tail,
            high_N=change.value + tail,
        )


@dataclass(frozen=True, slots=True)
class BatchAsPrior:
    """What is known of the batch as prior.

    Parameters
    ----------
    sensors : sensors that a model can be learned from.
    why : why what the prior would have cost is not known; empty if it is.
    changes : its effect on each way.
    """

    sensors: int
    why: str = ""
    changes: tuple[BatchChange, ...] = ()


def restore(kind: type[T], document: Mapping[str, Any]) -> T:
    """Return a finished piece of a sweep from its document, field by field of the right type.

    StoreError if a field is missing, unknown, of another type, or not finite.
    """
    try:
        adapter = TypeAdapter(kind)
        piece = adapter.validate_json(json.dumps(document), strict=True)
        complete = adapter.dump_python(piece, mode="json")
        stored = {"pareto": None, **document} if "pareto" in complete else document  # absent in older documents
        differing_keys = [
            key for key in {**complete, **stored} if key not in stored or complete.get(key) != stored[key]
        ]
        if not differing_keys:
            return piece
        why = f"{differing_keys[0]}: incomplete or unknown"
    except ValidationError as error:
        (first, *_) = error.errors()
        why = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    except NumericsError as error:
        why = error.reason
    raise StoreError(
        f"a stored {kind.__name__} of the frontier cannot be read ({why})",
        remedy="begin again with --fresh: what was kept is measured again",
    )
