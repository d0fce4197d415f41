"""The paper's grid: every location at every strain, a number of times."""

from collections.abc import Iterator
from typing import Any

from cbsr_qa.domain.loads import NINE_LOCATIONS_MM, Load
from cbsr_qa.domain.steps import Role, Step
from cbsr_qa.interfaces import SequenceContext
from cbsr_qa_plugins.sequences._cycle import find_surfaces, press_cycle, unloaded
from cbsr_qa_plugins.sequences._options import UNLOADED_FRAMES, Options

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
