"""Presses given one by one: those of a publication, or of a list somebody else pressed."""

from collections.abc import Iterator, Mapping
from math import cos, radians, sin
from typing import Any

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.loads import Load
from cbsr_qa.domain.steps import Role, Step
from cbsr_qa.interfaces import SequenceContext
from cbsr_qa_plugins.sequences._cycle import find_surfaces, press_cycle, unloaded
from cbsr_qa_plugins.sequences._options import UNLOADED_FRAMES, Options

_NAME = "given-loads"
_KNOWN = ("loads", "trials", "hold_s", "rest_s", "initial_rest_s", "find_surface", "unloaded_frames", "label")
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
        given = Options(_NAME, options, _KNOWN)
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
