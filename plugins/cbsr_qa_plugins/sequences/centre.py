"""Up through some strains and down through the same, without lifting the head between.

Noise of the rested sheet, and the response to a centre load that its noise figure is taken from.

One long press and one long rest: how the sheet settles after loading and after unloading.

Presses that work the sheet in before anything is measured.
"""

from collections.abc import Iterator
from typing import Any

from cbsr_qa.domain import ConfigError
from cbsr_qa.domain.plan import Ease, Hold, Press, Release, Role, Step
from cbsr_qa.domain.run import NINE_LOCATIONS_MM, Load
from cbsr_qa.plugin import SequenceContext
from cbsr_qa_plugins.sequences._shared import UNLOADED_FRAMES, Options, find_surfaces, press_cycle, unloaded

_KNOWN = ("rest_s", "frames", "strain_percent", "hold_s", "trials", "recovery_s", "find_surface")


class NoiseFigureSequence:
    """A long rest, many unloaded frames, then the centre load L0 a few times (science, section 6).

    Parameters
    ----------
    rest_s : rest before the unloaded frames; default 240.
    frames : unloaded frames; default 30, at least 16 (a noise floor and a reference apart from it).
    strain_percent : of the centre load; default 20.
    hold_s : default 60, so that frames after the steady state exist.
    trials : default 3.
    recovery_s : rest after each press; default 60.
    find_surface : whether the centre's surface is found first; default true.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range.
    """

    role = Role.NOISE

    def __init__(self, **options: Any) -> None:
        given = Options("noise-figure", options, _KNOWN)
        self._rest_s = given.duration_s("rest_s", 240.0)
        self._frames = given.whole("frames", 30, UNLOADED_FRAMES, 100_000)
        self._strain = given.strain("strain_percent", 20.0)
        self._hold_s = given.duration_s("hold_s", 60.0, shortest_s=1.0)
        self._trials = given.whole("trials", 3, 1, 1000)
        self._recovery_s = given.duration_s("recovery_s", 60.0)
        self._find_surface = given.flag("find_surface", True)

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time."""
        x_mm, y_mm = NINE_LOCATIONS_MM[0]
        if self._find_surface:
            yield from find_surfaces([(x_mm, y_mm)])
        yield from unloaded(self._rest_s, self._frames)
        for trial in range(self._trials):
            load = Load("L0", x_mm, y_mm, self._strain, trial)
            yield from press_cycle(load, hold_s=self._hold_s, rest_s=self._recovery_s)


_KNOWN_RELAXATION = (
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
        given = Options("relaxation", options, _KNOWN_RELAXATION)
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


_KNOWN_PRECONDITIONING = ("cycles", "strain_percent", "hold_s", "rest_s", "locations_mm", "find_surface")


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
        given = Options("preconditioning", options, _KNOWN_PRECONDITIONING)
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


_KNOWN_HYSTERESIS_LOOP = (
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
        given = Options("hysteresis-loop", options, _KNOWN_HYSTERESIS_LOOP)
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
