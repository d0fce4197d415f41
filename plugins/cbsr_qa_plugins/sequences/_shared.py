"""Runs of steps that every built-in sequence is made of.

Options of the built-in sequences: read once, checked fully, refused with what is allowed.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Any, Final

from cbsr_qa.domain import ConfigError
from cbsr_qa.domain.plan import AcquireFrames, FindSurface, Hold, MarkUnloaded, Press, Release, Step
from cbsr_qa.domain.run import Load

#: Lowest strain any sequence may be asked for [%]: 0.04 mm of a 4 mm sheet, less than one step of 0.05 mm in which
#: the head feels for the surface. Whoever asks for less has written a fraction instead of per cent.
STRAIN_FLOOR_PERCENT: Final = 1.0
#: Highest strain any sequence may be asked for [%]; what the station allows is checked by the runner besides.
STRAIN_CEILING_PERCENT: Final = 60.0
#: Longest single hold or rest [s].
LONGEST_S: Final = 86400.0
#: Unloaded frames before the first press: eight for the noise floor and eight others for the reference.
UNLOADED_FRAMES: Final = 16


class Options:
    """Options of one phase as the recipe gives them.

    Parameters
    ----------
    sequence : name of the sequence, for messages.
    given : the phase's options.
    known : every option the sequence has.

    Raises
    ------
    ConfigError
        If an option is unknown; names the nearest one that exists.
    """

    def __init__(self, sequence: str, given: Mapping[str, Any], known: tuple[str, ...]) -> None:
        self._sequence = sequence
        self._given = given
        for name in given:
            if name not in known:
                near = get_close_matches(name, known, n=1)
                hint = f"did you mean {near[0]!r}? " if near else ""
                raise ConfigError(
                    f"sequence {sequence!r} has no option {name!r}", remedy=f"{hint}allowed: {', '.join(known)}"
                )

    def number(self, name: str, default: float, low: float, high: float) -> float:
        """Return a number in [low, high]."""
        return self._number(name, self._given.get(name, default), low, high)

    def duration_s(self, name: str, default: float, *, shortest_s: float = 0.0) -> float:
        """Return a duration in [shortest_s, one day] seconds."""
        return self.number(name, default, shortest_s, LONGEST_S)

    def strain(self, name: str, default_percent: float) -> float:
        """Return a strain as a fraction, from an option in percent."""
        return self.strain_of(name, self._given.get(name, default_percent))

    def strain_of(self, name: str, percent: object) -> float:
        """Return one value of a strain option as a fraction; from the floor to the ceiling."""
        try:
            return self._number(name, percent, STRAIN_FLOOR_PERCENT, STRAIN_CEILING_PERCENT) / 100
        except ConfigError as error:
            if not isinstance(percent, float) or not 0 < percent < STRAIN_FLOOR_PERCENT:
                raise
            hint = f"{error.remedy}, in per cent: write {100 * percent:g} for the fraction {percent:g}"
            raise ConfigError(error.reason, remedy=hint) from None

    def whole(self, name: str, default: int, low: int, high: int) -> int:
        """Return a whole number in [low, high]."""
        value = self._given.get(name, default)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self._refused(name, value, f"a whole number from {low} to {high}")
        return value

    def flag(self, name: str, default: bool) -> bool:
        """Return true or false."""
        value = self._given.get(name, default)
        if not isinstance(value, bool):
            raise self._refused(name, value, "true or false")
        return value

    def word(self, name: str, default: str) -> str:
        """Return a text that is not empty."""
        value = self._given.get(name, default)
        if not isinstance(value, str) or not value.strip():
            raise self._refused(name, value, "a name")
        return value

    def interval(self, name: str, default: tuple[float, float], low: float, high: float) -> tuple[float, float]:
        """Return a pair [lowest, highest] of numbers, both in [low, high], rising or equal."""
        value = self._given.get(name, default)
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise self._refused(name, value, "a pair [lowest, highest]")
        first, second = (self._number(name, item, low, high) for item in value)
        if first > second:
            raise self._refused(name, value, "a pair [lowest, highest] with the lower one first")
        return first, second

    def items(self, name: str, default: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return a list of at least one entry, entries not yet checked."""
        value = self._given.get(name, default)
        if not isinstance(value, list | tuple) or not value:
            raise self._refused(name, value, "a list of at least one entry")
        return tuple(value)

    def places_mm(self, name: str, default: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        """Return a list of places [x, y] in mm from the sheet's centre."""
        places = []
        for item in self.items(name, default):
            if not isinstance(item, list | tuple) or len(item) != 2:
                raise self._refused(name, item, "places [x, y] in mm")
            places.append((self._number(name, item[0], -1e3, 1e3), self._number(name, item[1], -1e3, 1e3)))
        return tuple(places)

    def refuse_repeats(self, name: str, values: tuple[Any, ...], by: str = "trials") -> None:
        """Refuse a list that says the same thing twice: repeats are what the option ``by`` is for."""
        if len(set(values)) != len(values):
            raise self._refused(name, self._given.get(name), f"each entry once ({by} repeats them)")

    def _number(self, name: str, value: object, low: float, high: float) -> float:
        allowed = f"a number from {low:g} to {high:g}"
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self._refused(name, value, allowed)
        if not low <= value <= high:
            raise self._refused(name, value, allowed)
        return float(value)

    def _refused(self, name: str, found: object, allowed: str) -> ConfigError:
        return ConfigError(f"sequence {self._sequence!r}: {name} is {found!r}", remedy=f"allowed: {allowed}")


def find_surfaces(places_mm: Iterable[tuple[float, float]]) -> Iterator[Step]:
    """Find the surface at each different place, in the order they first occur."""
    for x_mm, y_mm in dict.fromkeys(places_mm):
        yield FindSurface(x_mm, y_mm)


def unloaded(rest_s: float, frames: int) -> Iterator[Step]:
    """Let the sheet rest, then take the frames that noise floor and reference come from.

    The rest itself takes no frames: nothing is drawn from them, and they would only fill the store.
    """
    if rest_s > 0:
        yield Hold(rest_s, acquire=False)
    yield MarkUnloaded()
    yield AcquireFrames(frames)


def press_cycle(load: Load, *, hold_s: float, rest_s: float) -> Iterator[Step]:
    """Press, hold, release and rest, taking frames through hold and rest (paper: 60 s on, 60 s off)."""
    yield Press(load)
    yield Hold(hold_s, acquire=True)
    yield Release()
    if rest_s > 0:
        yield Hold(rest_s, acquire=True)
