"""One long press and one long rest: how the sheet settles after loading and after unloading."""

from collections.abc import Iterator
from typing import Any

from cbsr_qa.domain.loads import NINE_LOCATIONS_MM, Load
from cbsr_qa.domain.steps import Role, Step
from cbsr_qa.interfaces import SequenceContext
from cbsr_qa_plugins.sequences._cycle import find_surfaces, press_cycle, unloaded
from cbsr_qa_plugins.sequences._options import UNLOADED_FRAMES, Options

_KNOWN = (
    "x_mm",
    "y_mm",
    "strain_percent",
    "hold_s",
    "rest_s",
    "trials",
    "initial_rest_s",
    "find_surface",
    "unloaded_frames",
)


class RelaxationSequence:
    """A press held until the slow exponential has died out, and a rest as long (science, section 7).

    The load is labelled by its place: L0 … L8 on the paper's nine locations, X0 elsewhere.

    Parameters
    ----------
    x_mm, y_mm : place; default the centre.
    strain_percent : default 20.
    hold_s, rest_s : default 240 and 240, about five of the paper's longest settling times.
    trials : default 1.
    initial_rest_s : rest after surface finding; default 240.
    find_surface : whether the surface is found first; default true.
    unloaded_frames : before the first press; default and least 16.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range.
    """

    role = Role.RELAXATION

    def __init__(self, **options: Any) -> None:
        given = Options("relaxation", options, _KNOWN)
        self._place_mm = (given.number("x_mm", 0.0, -1e3, 1e3), given.number("y_mm", 0.0, -1e3, 1e3))
        self._strain = given.strain("strain_percent", 20.0)
        self._hold_s = given.duration_s("hold_s", 240.0, shortest_s=1.0)
        self._rest_s = given.duration_s("rest_s", 240.0)
        self._trials = given.whole("trials", 1, 1, 1000)
        self._initial_rest_s = given.duration_s("initial_rest_s", 240.0)
        self._find_surface = given.flag("find_surface", True)
        self._unloaded_frames = given.whole("unloaded_frames", UNLOADED_FRAMES, UNLOADED_FRAMES, 100_000)

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time."""
        if self._find_surface:
            yield from find_surfaces([self._place_mm])
        yield from unloaded(self._initial_rest_s, self._unloaded_frames)
        for trial in range(self._trials):
            load = Load(_label(self._place_mm), *self._place_mm, self._strain, trial)
            yield from press_cycle(load, hold_s=self._hold_s, rest_s=self._rest_s)


def _label(place_mm: tuple[float, float]) -> str:
    return f"L{NINE_LOCATIONS_MM.index(place_mm)}" if place_mm in NINE_LOCATIONS_MM else "X0"
