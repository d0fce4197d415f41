"""Noise of the rested sheet, and the response to a centre load that its noise figure is taken from."""

from collections.abc import Iterator
from typing import Any

from cbsr_qa.domain.loads import NINE_LOCATIONS_MM, Load
from cbsr_qa.domain.steps import Role, Step
from cbsr_qa.interfaces import SequenceContext
from cbsr_qa_plugins.sequences._cycle import find_surfaces, press_cycle, unloaded
from cbsr_qa_plugins.sequences._options import UNLOADED_FRAMES, Options

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
