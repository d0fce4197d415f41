"""Presses of unknown place and strain: what a sensor meets in the field.

The paper's grid: every location at every strain, a number of times.

Presses given one by one: those of a publication, or of a list somebody else pressed.
"""

import hashlib
from collections.abc import Iterator, Mapping
from math import cos, radians, sin
from typing import Any

import numpy as np

from cbsr_qa.domain import ConfigError
from cbsr_qa.domain.plan import Role, Step
from cbsr_qa.domain.run import NINE_LOCATIONS_MM, Load
from cbsr_qa.plugin import SequenceContext
from cbsr_qa_plugins.sequences._shared import (
    STRAIN_CEILING_PERCENT,
    UNLOADED_FRAMES,
    Options,
    find_surfaces,
    press_cycle,
    unloaded,
)

_KNOWN = (
    "strains_percent",
    "trials",
    "hold_s",
    "rest_s",
    "locations_mm",
    "initial_rest_s",
    "find_surface",
    "unloaded_frames",
    "label",
)


class LocationGridSequence:
    """Press each location at each strain; locations are the innermost loop.

    Going round the sheet before a place is pressed again gives its residue the longest time to fade, and
    spreads drift over the trials of a place instead of hiding it between places.

    Parameters
    ----------
    strains_percent : default [20]; the paper's campaign is [5, 10, 15, 20, 25, 30].
    trials : of each location and strain; default 1 (the paper's campaign: 3).
    hold_s, rest_s : default 60 and 60.
    locations_mm : [x, y] each, labelled L0, L1, … in order; default the paper's nine.
    label : what labels begin with; default L. Two grids of one recipe tell their places apart by it.
    initial_rest_s : rest after surface finding; default 240.
    find_surface : whether the surface is found at every location first; default true.
    unloaded_frames : before the first press; default and least 16.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range, or a location or strain is given twice.
    """

    role = Role.GRID

    def __init__(self, **options: Any) -> None:
        given = Options("location-grid", options, _KNOWN)
        self._strains = tuple(given.strain_of("strains_percent", s) for s in given.items("strains_percent", (20.0,)))
        self._trials = given.whole("trials", 1, 1, 1000)
        self._hold_s = given.duration_s("hold_s", 60.0, shortest_s=1.0)
        self._rest_s = given.duration_s("rest_s", 60.0)
        self._places_mm = given.places_mm("locations_mm", NINE_LOCATIONS_MM)
        self._initial_rest_s = given.duration_s("initial_rest_s", 240.0)
        self._find_surface = given.flag("find_surface", True)
        self._unloaded_frames = given.whole("unloaded_frames", UNLOADED_FRAMES, UNLOADED_FRAMES, 100_000)
        self._label = given.word("label", "L")
        given.refuse_repeats("strains_percent", self._strains)
        given.refuse_repeats("locations_mm", self._places_mm)

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time."""
        if self._find_surface:
            yield from find_surfaces(self._places_mm)
        yield from unloaded(self._initial_rest_s, self._unloaded_frames)
        for load in self._loads():
            yield from press_cycle(load, hold_s=self._hold_s, rest_s=self._rest_s)

    def _loads(self) -> Iterator[Load]:
        for strain in self._strains:
            for trial in range(self._trials):
                for number, (x_mm, y_mm) in enumerate(self._places_mm):
                    yield Load(f"{self._label}{number}", x_mm, y_mm, strain, trial)


_NAME = "given-loads"
_KNOWN_GIVEN_LOADS = (
    "loads",
    "trials",
    "hold_s",
    "rest_s",
    "initial_rest_s",
    "find_surface",
    "unloaded_frames",
    "label",
)
_CARTESIAN = ("x_mm", "y_mm")
_POLAR = ("radius_mm", "angle_deg")


class GivenLoadsSequence:
    """Press a list of loads in its order, a number of times.

    Parameters
    ----------
    loads : tables of ``strain_percent`` and a place, which is either ``x_mm`` and ``y_mm``, or ``radius_mm`` and
        ``angle_deg`` (counterclockwise from the x axis), as the paper's Table 5 gives it. There is no default.
    trials : of the whole list; default 1.
    hold_s, rest_s : default 60 and 60.
    initial_rest_s : rest after surface finding; default 240.
    find_surface : whether the surface is found at every place first; default true.
    unloaded_frames : before the first press; default and least 16.
    label : what labels begin with; default R.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range, or a load has no place, or two.
    """

    role = Role.RANDOM

    def __init__(self, **options: Any) -> None:
        given = Options(_NAME, options, _KNOWN_GIVEN_LOADS)
        self._label = given.word("label", "R")
        self._loads = tuple(self._load(number, item) for number, item in enumerate(given.items("loads", ())))
        if not self._loads:
            raise ConfigError(f"sequence {_NAME!r} needs the option 'loads'", remedy="give at least one load")
        self._trials = given.whole("trials", 1, 1, 1000)
        self._hold_s = given.duration_s("hold_s", 60.0, shortest_s=1.0)
        self._rest_s = given.duration_s("rest_s", 60.0)
        self._initial_rest_s = given.duration_s("initial_rest_s", 240.0)
        self._find_surface = given.flag("find_surface", True)
        self._unloaded_frames = given.whole("unloaded_frames", UNLOADED_FRAMES, UNLOADED_FRAMES, 100_000)

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time."""
        if self._find_surface:
            yield from find_surfaces((load.x_mm, load.y_mm) for load in self._loads)
        yield from unloaded(self._initial_rest_s, self._unloaded_frames)
        for trial in range(self._trials):
            for load in self._loads:
                again = Load(load.label, load.x_mm, load.y_mm, load.strain, trial)
                yield from press_cycle(again, hold_s=self._hold_s, rest_s=self._rest_s)

    def _load(self, number: int, item: object) -> Load:
        where = f"{_NAME}, load {number + 1}"
        if not isinstance(item, Mapping):
            raise ConfigError(f"sequence {where}: {item!r} is no table", remedy=f"allowed: {_forms()}")
        keys = set(item)
        if keys not in ({*_CARTESIAN, "strain_percent"}, {*_POLAR, "strain_percent"}):
            raise ConfigError(
                f"sequence {where} has {', '.join(sorted(map(str, keys)))}", remedy=f"allowed: {_forms()}"
            )
        given = Options(where, item, (*_CARTESIAN, *_POLAR, "strain_percent"))
        x_mm, y_mm = given.number("x_mm", 0.0, -1e3, 1e3), given.number("y_mm", 0.0, -1e3, 1e3)
        if "radius_mm" in keys:
            radius_mm = given.number("radius_mm", 0.0, 0.0, 1e3)
            angle = radians(given.number("angle_deg", 0.0, -360.0, 360.0))
            x_mm, y_mm = (round(radius_mm * part, 2) + 0.0 for part in (cos(angle), sin(angle)))  # no −0
        return Load(f"{self._label}{number}", x_mm, y_mm, given.strain("strain_percent", 0.0), 0)


def _forms() -> str:
    return f"strain_percent with {' and '.join(_CARTESIAN)}, or with {' and '.join(_POLAR)}"


_NAME_RANDOM_LOADS = "random-loads"
_KNOWN_RANDOM_LOADS = (
    "count",
    "radius_mm",
    "strain_percent",
    "hold_s",
    "rest_s",
    "initial_rest_s",
    "find_surface",
    "unloaded_frames",
    "stream",
)


class RandomLoadsSequence:
    """Seeded random loads R0, R1, …, uniform in radius, angle and strain (paper 3.3).

    The paper says radii of 0–40 % of the domain *radius*; its table reaches 35.8 mm of 50, so 40 % of the
    *diameter* is what was run, and the default here. Uniform in radius, not in area, as in the paper.

    Numbers come from a Philox stream keyed by (seed, ``stream``), three a load, so that a longer list begins
    with the shorter one and no other use of the seed changes them. Coordinates are cut towards zero to
    0.01 mm (a load never lies beyond the highest radius; it may lie up to 0.015 mm inside the lowest) and
    strains rounded to 0.01 %: what the report prints is what was done.

    Parameters
    ----------
    count : default 10.
    radius_mm : [lowest, highest]; default [0, 40].
    strain_percent : [lowest, highest]; default [5, 30].
    hold_s, rest_s : default 60 and 60.
    initial_rest_s : rest after surface finding; default 240.
    find_surface : whether the surface is found at every place first; default true.
    unloaded_frames : before the first press; default and least 16.
    stream : name of the random stream; two phases of one recipe draw different loads under different names.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range.
    """

    role = Role.RANDOM

    def __init__(self, **options: Any) -> None:
        given = Options(_NAME_RANDOM_LOADS, options, _KNOWN_RANDOM_LOADS)
        self._count = given.whole("count", 10, 1, 10_000)
        self._radius_mm = given.interval("radius_mm", (0.0, 40.0), 0.0, 1e3)
        self._strain_percent = given.interval("strain_percent", (5.0, 30.0), 0.0, STRAIN_CEILING_PERCENT)
        for percent in self._strain_percent:
            given.strain_of("strain_percent", percent)
        self._hold_s = given.duration_s("hold_s", 60.0, shortest_s=1.0)
        self._rest_s = given.duration_s("rest_s", 60.0)
        self._initial_rest_s = given.duration_s("initial_rest_s", 240.0)
        self._find_surface = given.flag("find_surface", True)
        self._unloaded_frames = given.whole("unloaded_frames", UNLOADED_FRAMES, UNLOADED_FRAMES, 100_000)
        self._stream = given.word("stream", _NAME_RANDOM_LOADS)

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time for one seed."""
        loads = self._loads(context.seed)
        if self._find_surface:
            yield from find_surfaces((load.x_mm, load.y_mm) for load in loads)
        yield from unloaded(self._initial_rest_s, self._unloaded_frames)
        for load in loads:
            yield from press_cycle(load, hold_s=self._hold_s, rest_s=self._rest_s)

    def _loads(self, seed: int) -> tuple[Load, ...]:
        draws = _generator(seed, self._stream).random((self._count, 3))
        return tuple(self._load(number, *map(float, draw)) for number, draw in enumerate(draws))

    def _load(self, number: int, first: float, second: float, third: float) -> Load:
        radius_mm = _between(self._radius_mm, first)
        angle = 2 * np.pi * second
        place_mm = np.trunc(100 * radius_mm * np.array([np.cos(angle), np.sin(angle)])) / 100 + 0.0  # no −0
        percent = min(
            max(round(_between(self._strain_percent, third), 2), self._strain_percent[0]), self._strain_percent[1]
        )
        return Load(f"R{number}", float(place_mm[0]), float(place_mm[1]), percent / 100, 0)


def _between(bounds: tuple[float, float], share: float) -> float:
    return bounds[0] + (bounds[1] - bounds[0]) * share


def _generator(seed: int, stream: str) -> np.random.Generator:
    digest = hashlib.sha256(f"{seed}/{stream}".encode()).digest()
    return np.random.Generator(np.random.Philox(key=int.from_bytes(digest[:16], "big")))
