"""Press cycles on a strip of the material, strain by strain (paper 2.2.1)."""

import hashlib
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from cbsr_qa.domain import ConfigError
from cbsr_qa.domain.plan import Role, Step
from cbsr_qa.domain.run import Load
from cbsr_qa.plugin import SequenceContext
from cbsr_qa_plugins.sequences._shared import UNLOADED_FRAMES, Options, find_surfaces, press_cycle, unloaded

_NAME: Final = "characterisation"
_KNOWN: Final = (
    "strains_percent",
    "cycles",
    "order",
    "hold_s",
    "rest_s",
    "initial_rest_s",
    "find_surface",
    "unloaded_frames",
    "x_mm",
    "y_mm",
)
_ORDERS: Final = ("as given", "shuffled")


class CharacterisationSequence:
    """Press one place a number of times at each strain, all cycles of a strain in a row.

    Loads are labelled C1, C2, … by strain in the order given; a cycle is a trial of its strain.

    Parameters
    ----------
    strains_percent : default the paper's [5, 10, 15, 20, 25, 30].
    cycles : at each strain; default 10.
    order : ``"as given"``, or ``"shuffled"`` by the run's seed, so that drift of the material does not pass for a
        dependence on strain.
    hold_s, rest_s : default 60 and 60: a period of 120 s, half of it pressed.
    initial_rest_s : rest after surface finding; default 240.
    find_surface : whether the surface is found first; default true.
    unloaded_frames : before the first press; default 60, least 16.
    x_mm, y_mm : place; default the strip's centre.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range, or a strain is given twice.
    """

    role = Role.CHARACTERISATION

    def __init__(self, **options: Any) -> None:
        given = Options(_NAME, options, _KNOWN)
        paper = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
        self._strains = tuple(given.strain_of("strains_percent", s) for s in given.items("strains_percent", paper))
        self._cycles = given.whole("cycles", 10, 1, 1000)
        self._order = given.word("order", "as given")
        self._hold_s = given.duration_s("hold_s", 60.0, shortest_s=1.0)
        self._rest_s = given.duration_s("rest_s", 60.0, shortest_s=1.0)
        self._initial_rest_s = given.duration_s("initial_rest_s", 240.0)
        self._find_surface = given.flag("find_surface", True)
        self._unloaded_frames = given.whole("unloaded_frames", 60, UNLOADED_FRAMES, 100_000)
        self._place_mm = (given.number("x_mm", 0.0, -1e3, 1e3), given.number("y_mm", 0.0, -1e3, 1e3))
        given.refuse_repeats("strains_percent", self._strains, "cycles")
        if self._order not in _ORDERS:
            raise ConfigError(
                f"sequence {_NAME!r}: order is {self._order!r}", remedy=f"allowed: {', '.join(map(repr, _ORDERS))}"
            )

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time for one seed."""
        if self._find_surface:
            yield from find_surfaces([self._place_mm])
        yield from unloaded(self._initial_rest_s, self._unloaded_frames)
        for number in self._numbers(context.seed):
            for cycle in range(self._cycles):
                load = Load(f"C{number + 1}", *self._place_mm, self._strains[number], cycle)
                yield from press_cycle(load, hold_s=self._hold_s, rest_s=self._rest_s)

    def _numbers(self, seed: int) -> list[int]:
        """Strains by number, in the order they are pressed."""
        numbers = np.arange(len(self._strains))
        if self._order == "shuffled":
            key = int.from_bytes(hashlib.sha256(f"{seed}/{_NAME}".encode()).digest()[:16])
            np.random.Generator(np.random.Philox(key=key)).shuffle(numbers)
        return [int(number) for number in numbers]
