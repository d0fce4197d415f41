"""A point of the frontier: a setting, its accuracy relative to known truth, and its cost in time."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal, TypeVar

from pydantic import TypeAdapter, ValidationError

from cbsr_qa.domain.errors import NumericsError, StoreError

#: Direction of more accurate values: larger, smaller, or near a stated value (such values are not compared).
Better = Literal["more", "less", "stated"]
#: Setting of a knob: a name, a switch, or a number.
Knob = str | bool | int | float

T = TypeVar("T")


class TimeBasis(StrEnum):
    """Kind of time."""

    COMPUTER = "computer"  #: seconds of one core
    STATION = "station"  #: seconds a sensor occupies the rig
    PRESSES = "presses"  #: number of presses


@dataclass(frozen=True, slots=True)
class Accuracy:
    """One value of a setting relative to known truth, or its mean over seeds.

    Parameters
    ----------
    stderr : standard error of that mean; None if the value is exact, or from a single seed.
    better : direction of more accurate values: larger (an overlap), smaller (an error), or near to a stated value.
    """

    value: float
    stderr: float | None
    unit: str
    better: Better = "less"

    def __post_init__(self) -> None:
        stderr = self.stderr or 0.0
        if not (math.isfinite(self.value) and math.isfinite(stderr)) or stderr < 0:
            raise NumericsError(
                f"an accuracy of {self.value} ± {self.stderr} {self.unit} is not a finite number with an error of it",
                remedy="leave out a value that could not be determined, and say so in the point's note",
            )

    @property
    def upper(self) -> float:
        """The value plus its standard error, to allow for chance."""
        return self.value + (self.stderr or 0.0)

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
