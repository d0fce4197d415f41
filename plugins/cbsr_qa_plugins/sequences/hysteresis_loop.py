"""Up through some strains and down through the same, without lifting the head between."""

from collections.abc import Iterator
from typing import Any

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.loads import Load
from cbsr_qa.domain.steps import Ease, Hold, Press, Release, Role, Step
from cbsr_qa.interfaces import SequenceContext
from cbsr_qa_plugins.sequences._cycle import find_surfaces, unloaded
from cbsr_qa_plugins.sequences._options import UNLOADED_FRAMES, Options

_KNOWN = (
    "strains_percent",
    "cycles",
    "hold_s",
    "rest_s",
    "locations_mm",
    "label",
    "initial_rest_s",
    "find_surface",
    "unloaded_frames",
)


class HysteresisLoopSequence:
    """Press to the lowest strain, ease up to the highest one by one and down again, release, and rest.

    Every strain is held equally long, on the way up and down, so that each reading is as old as its counterpart; the
    highest is held once. Cycles of a location follow each other. A loop is one load: it is the calibration cycle of
    ISA-37.1, and a run that was interrupted begins it anew.

    Parameters
    ----------
    strains_percent : rising; at least two, default [7.5, 15, 22.5, 30]. Half of the highest is where most loops are
        widest.
    cycles : loops at each location; default 3 (with 2 and more their scatter is known).
    hold_s, rest_s : at each strain, and after each loop; default 60 and 120.
    locations_mm : [x, y] each, labelled H0, H1, … in order; default the centre.
    label : what labels begin with; default H.
    initial_rest_s : rest after surface finding; default 240.
    find_surface : whether the surface is found at every location first; default true.
    unloaded_frames : before the first press; default and least 16.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range, a location is given twice, or strains do not rise.
    """

    role = Role.LOOP

    def __init__(self, **options: Any) -> None:
        given = Options("hysteresis-loop", options, _KNOWN)
        asked = given.items("strains_percent", (7.5, 15.0, 22.5, 30.0))
        self._strains = tuple(given.strain_of("strains_percent", strain) for strain in asked)
        if len(asked) < 2 or list(self._strains) != sorted(set(self._strains)):
            raise ConfigError(
                f"sequence 'hysteresis-loop': strains_percent is {list(asked)!r}",
                remedy="allowed: at least two strains, each above the one before; the way back is the same downwards",
            )
        self._cycles = given.whole("cycles", 3, 1, 1000)
        self._hold_s = given.duration_s("hold_s", 60.0, shortest_s=1.0)
        self._rest_s = given.duration_s("rest_s", 120.0)
        self._places_mm = given.places_mm("locations_mm", ((0.0, 0.0),))
        self._label = given.word("label", "H")
        self._initial_rest_s = given.duration_s("initial_rest_s", 240.0)
        self._find_surface = given.flag("find_surface", True)
        self._unloaded_frames = given.whole("unloaded_frames", UNLOADED_FRAMES, UNLOADED_FRAMES, 100_000)
        given.refuse_repeats("locations_mm", self._places_mm, "cycles")

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time."""
        if self._find_surface:
            yield from find_surfaces(self._places_mm)
        yield from unloaded(self._initial_rest_s, self._unloaded_frames)
        for number, (x_mm, y_mm) in enumerate(self._places_mm):
            for cycle in range(self._cycles):
                yield from self._loop(Load(f"{self._label}{number}", x_mm, y_mm, self._strains[0], cycle))

    def _loop(self, load: Load) -> Iterator[Step]:
        yield Press(load)
        yield Hold(self._hold_s, acquire=True)
        for strain in (*self._strains[1:], *self._strains[-2::-1]):
            yield Ease(strain)
            yield Hold(self._hold_s, acquire=True)
        yield Release()
        if self._rest_s > 0:
            yield Hold(self._rest_s, acquire=True)
