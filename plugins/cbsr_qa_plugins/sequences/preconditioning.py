"""Presses that work the sheet in before anything is measured."""

from collections.abc import Iterator
from typing import Any

from cbsr_qa.domain.loads import NINE_LOCATIONS_MM, Load
from cbsr_qa.domain.steps import Role, Step
from cbsr_qa.interfaces import SequenceContext
from cbsr_qa_plugins.sequences._cycle import find_surfaces, press_cycle
from cbsr_qa_plugins.sequences._options import Options

_KNOWN = ("cycles", "strain_percent", "hold_s", "rest_s", "locations_mm", "find_surface")


class PreconditioningSequence:
    """Press and release each location a fixed number of times, one location after the other (Mullins 1969).

    Filled rubber is softer after its first deformations, and keeps what a given strain has done to it until it is
    strained further: the strain here should be the highest of the rest of the recipe. The number of cycles is fixed
    and is the number of trials of each location; the metric ``preconditioning-change`` says what the last one still
    changed. No frame of it is a reference: the phase after it rests and takes the unloaded frames, so it must not be
    the only phase of a recipe.

    Parameters
    ----------
    cycles : of each location; default 5, at least 2 (a change needs two).
    strain_percent : default 30, the paper's highest.
    hold_s, rest_s : default 10 and 10.
    locations_mm : [x, y] each, labelled L0, L1, … in order; default the paper's nine.
    find_surface : whether the surface is found at every location first; default true.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range, or a location is given twice.
    """

    role = Role.PRECONDITIONING

    def __init__(self, **options: Any) -> None:
        given = Options("preconditioning", options, _KNOWN)
        self._cycles = given.whole("cycles", 5, 2, 1000)
        self._strain = given.strain("strain_percent", 30.0)
        self._hold_s = given.duration_s("hold_s", 10.0, shortest_s=1.0)
        self._rest_s = given.duration_s("rest_s", 10.0, shortest_s=1.0)
        self._places_mm = given.places_mm("locations_mm", NINE_LOCATIONS_MM)
        self._find_surface = given.flag("find_surface", True)
        given.refuse_repeats("locations_mm", self._places_mm, "cycles")

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time."""
        if self._find_surface:
            yield from find_surfaces(self._places_mm)
        for number, (x_mm, y_mm) in enumerate(self._places_mm):
            for cycle in range(self._cycles):
                load = Load(f"L{number}", x_mm, y_mm, self._strain, cycle)
                yield from press_cycle(load, hold_s=self._hold_s, rest_s=self._rest_s)
