"""A point of the frontier: a setting, how accurate it is against known truth, and what it costs in time."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from cbsr_qa.domain import NumericsError, StoreError

#: What a knob is set to: a name, a number, or whether something is on.
Knob = str | float | int


class Clock(StrEnum):
    """Which time a setting costs."""

    COMPUTER = "computer"  #: seconds of one core
    STATION = "station"  #: seconds a sensor occupies the rig


@dataclass(frozen=True, slots=True)
class Accuracy:
    """One figure of a setting against known truth.

    Parameters
    ----------
    value : of the figure, in ``unit``; a mean over seeds where there are several.
    stderr : standard error of that mean; None where the figure is exact, or one seed says nothing about it.
    unit : ``"1"`` for relative figures.
    more_is_better : whether larger values are more accurate (an overlap) instead of less (an error).
    """

    value: float
    stderr: float | None
    unit: str
    more_is_better: bool = False

    def __post_init__(self) -> None:
        known = () if self.stderr is None else (self.stderr,)
        if not all(math.isfinite(one) for one in (self.value, *known)) or min(known, default=0.0) < 0:
            raise NumericsError(
                f"an accuracy of {self.value} ± {self.stderr} {self.unit} is not a finite number with an error of it",
                remedy="leave a figure that could not be determined out, and say so in the point's note",
            )

    @property
    def shortfall(self) -> float:
        """The value with its sign such that less is better."""
        return -self.value if self.more_is_better else self.value

    def document(self) -> dict[str, Any]:
        """Return what ``--json`` prints for it."""
        return {
            "value": self.value,
            "stderr": self.stderr,
            "unit": self.unit,
            "better": "more" if self.more_is_better else "less",
        }


@dataclass(frozen=True, slots=True)
class Point:
    """A setting that was tried.

    Parameters
    ----------
    clock : whose time the series is about.
    series : sweep it belongs to, e.g. ``"forward-model"``; points are compared within one.
    knobs : what was set.
    accuracy : figures against known truth by name; one that could not be determined is absent.
    compute_s : time of the computer [s]: of one frame or one solution for imaging and forward models; None where it
        was not measured.
    station_s : time a sensor occupies the rig [s]; None for settings of the computer alone.
    seeds : how many repetitions with other random numbers the figures are means of; 1 where nothing is random.
    note : what an engineer should know of it; may be empty.
    costs : what it costs besides, by name with the unit in it (``setup_s``, ``memory_bytes``, ``unknowns``).
    """

    clock: Clock
    series: str
    knobs: Mapping[str, Knob]
    accuracy: Mapping[str, Accuracy]
    compute_s: float | None
    station_s: float | None
    seeds: int
    note: str = ""
    costs: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        numbers = {"compute_s": self.compute_s, "station_s": self.station_s, **self.costs}
        numbers |= {name: value for name, value in self.knobs.items() if not isinstance(value, str)}
        wrong = [name for name, value in numbers.items() if value is not None and not math.isfinite(value)]
        if wrong or self.seeds < 1:
            what = f"{wrong[0]} of {numbers[wrong[0]]}" if wrong else f"{self.seeds} seeds"
            raise NumericsError(f"a point of series {self.series!r} has {what}", remedy="give finite numbers")

    def document(self, *, pareto: bool | None = None) -> dict[str, Any]:
        """Return what ``--json`` prints for it.

        Parameters
        ----------
        pareto : whether no other setting dominates this one; left out where nobody has compared yet.
        """
        said: dict[str, Any] = {
            "clock": self.clock.value,
            "series": self.series,
            "knobs": dict(self.knobs),
            "accuracy": {name: figure.document() for name, figure in self.accuracy.items()},
            "compute_s": self.compute_s,
            "station_s": self.station_s,
            "seeds": self.seeds,
            "note": self.note,
            "costs": dict(self.costs),
        }
        return said if pareto is None else {**said, "pareto": pareto}

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> "Point":
        """Return the point of a document, whether or not anybody compared it.

        Raises
        ------
        StoreError
            If something is missing in it or of another type.
        """
        try:
            return _point(document)
        except (KeyError, TypeError, ValueError, AttributeError, NumericsError) as error:
            raise StoreError(
                f"a stored point of the frontier cannot be read ({type(error).__name__}: {error})",
                remedy="remove the file of stored points; what it held is measured again",
            ) from error


@dataclass(frozen=True, slots=True)
class Task:
    """A point that is still to be measured, on its own and in any process.

    Parameters
    ----------
    key : says what is measured and with which versions; the same in every process, so that a finished point is found
        again.
    what : the same for people.
    run : measures it; can be pickled.
    """

    key: str
    what: str
    run: Callable[[], Point]


def _point(document: Mapping[str, Any]) -> Point:
    return Point(
        Clock(document["clock"]),
        _text(document["series"]),
        {_text(name): _knob(value) for name, value in document["knobs"].items()},
        {_text(name): _accuracy(figure) for name, figure in document["accuracy"].items()},
        _number_or_none(document["compute_s"]),
        _number_or_none(document["station_s"]),
        _whole(document["seeds"]),
        _text(document["note"]),
        {_text(name): _number(value) for name, value in document["costs"].items()},
    )


def _accuracy(figure: Mapping[str, Any]) -> Accuracy:
    better = {"more": True, "less": False}[figure["better"]]
    return Accuracy(_number(figure["value"]), _number_or_none(figure["stderr"]), _text(figure["unit"]), better)


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is not text")
    return value


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r} is not a number")
    return value


def _whole(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{value!r} is not a whole number")
    return value


def _number_or_none(value: object) -> float | None:
    return None if value is None else _number(value)


def _knob(value: object) -> Knob:
    return value if isinstance(value, str | bool) else _number(value)
