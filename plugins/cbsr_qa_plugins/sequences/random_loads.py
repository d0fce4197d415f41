"""Presses of unknown place and strain: what a sensor meets in the field."""

import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from cbsr_qa.domain.loads import Load
from cbsr_qa.domain.steps import Role, Step
from cbsr_qa.interfaces import SequenceContext
from cbsr_qa_plugins.sequences._cycle import find_surfaces, press_cycle, unloaded
from cbsr_qa_plugins.sequences._options import STRAIN_CEILING_PERCENT, UNLOADED_FRAMES, Options

_NAME = "random-loads"
_KNOWN = (
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
        given = Options(_NAME, options, _KNOWN)
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
        self._stream = given.word("stream", _NAME)

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
