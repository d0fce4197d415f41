"""Press cycles on a strip of the material, strain by strain (paper 2.2.1)."""

import hashlib
from collections.abc import Iterator
from typing import Annotated, Final, Literal

import numpy as np

from cbsr_qa.plugin import Load, Role, SequenceContext, Step, WithOptions
from cbsr_qa_plugins.sequences import parts

_NAME: Final = "characterisation"


class CharacterisationSequence(WithOptions):
    """Press one place a number of times at each strain, one strain after the other.

    Loads are labelled C1, C2, … by strain in the order given; a cycle is a trial of its strain.

    Parameters
    ----------
    strains_percent : strains of the presses, in order.
    cycles : number of cycles at each strain.
    order : ``"as given"``, or ``"shuffled"`` by the run's seed, so that drift of the material does not look like a
        dependence on strain.
    hold_s : time pressed.
    rest_s : rest after each press; the defaults make a period of 120 s, half of it pressed.
    initial_rest_s : rest after surface finding.
    find_surface : whether the surface is found first.
    unloaded_frames : number of unloaded frames before the first press.
    x_mm, y_mm : place; default the strip's centre.

    """

    class Options(parts.RestedOptions):
        strains_percent: Annotated[parts.Strains, parts.once("cycles")] = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
        cycles: parts.Times = 10
        order: Literal["as given", "shuffled"] = "as given"
        hold_s: parts.Held = 60.0
        rest_s: parts.Held = 60.0
        unloaded_frames: parts.Frames = 60
        x_mm: parts.Coordinate = 0.0
        y_mm: parts.Coordinate = 0.0

    role = Role.CHARACTERISATION
    options: Options

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time for one seed."""
        options, place_mm = self.options, (self.options.x_mm, self.options.y_mm)
        loads = [
            Load(f"C{number + 1}", *place_mm, options.strains_percent[number] / 100, cycle)
            for number in self._numbers(context.seed)
            for cycle in range(options.cycles)
        ]
        yield from parts.presses(options, loads, hold_s=options.hold_s, rest_s=options.rest_s, context=context)

    def _numbers(self, seed: int) -> list[int]:
        """Strains by number, in the order they are pressed."""
        numbers = np.arange(len(self.options.strains_percent))
        if self.options.order == "shuffled":
            key = int.from_bytes(hashlib.sha256(f"{seed}/{_NAME}".encode()).digest()[:16])
            np.random.Generator(np.random.Philox(key=key)).shuffle(numbers)
        return [int(number) for number in numbers]
