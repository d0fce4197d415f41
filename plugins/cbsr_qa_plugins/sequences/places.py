"""Sequences of presses at many places: on a grid, from a list, and at random.

The grid is the paper's: every location at every strain, a number of times. Listed presses may come from a
publication. Random ones have unknown place and strain, as in the field.
"""

import hashlib
from collections.abc import Iterator
from math import cos, radians, sin
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from cbsr_qa.plugin import (
    NINE_LOCATIONS_MM,
    Array,
    Load,
    PluginOptions,
    Problem,
    Role,
    SequenceContext,
    Step,
    WithOptions,
)
from cbsr_qa_plugins.sequences import parts


class LocationGridSequence(WithOptions):
    """Press each location at each strain; locations are the innermost loop.

    Going round the sheet before a place is pressed again gives its residue the longest time to fade, and
    spreads drift over the trials of a place instead of hiding it between places.

    Parameters
    ----------
    strains_percent : strains of the presses; the paper's campaign is [5, 10, 15, 20, 25, 30].
    trials : number of presses of each location and strain (the paper's campaign: 3).
    hold_s : time pressed.
    rest_s : rest after each press.
    locations_mm : [x, y] each, labelled L0, L1, … in order.
    label : prefix of the labels. A label stands for one place in all grids and loops of a recipe.
    initial_rest_s : rest after surface finding.
    find_surface : whether the surface is found at every location first.
    unloaded_frames : number of unloaded frames before the first press.
    unloaded_before : an earlier phase took them: four are enough.
    clearance_mm : travel height above the sheet; by default the hover height.
    residue_percent : rests end at this predicted residue at the next place, of its change.
    least_rest_s : shortest such rest.
    surface : ``"plane"`` is found at three places only.
    touches_mm : those places; by default far apart.
    surface_tolerance_mm : of contacts and a fourth touch.
    drift : of readings, in noise of a frame, at which the first rest ends.
    least_initial_rest_s : shortest such rest.

    """

    class Options(parts.QuickOptions):
        strains_percent: Annotated[parts.Strains, parts.once("trials")] = (20.0,)
        trials: parts.Times = 1
        hold_s: parts.Held = 60.0
        rest_s: parts.Rest = 60.0
        locations_mm: Annotated[parts.Places, parts.once("trials")] = NINE_LOCATIONS_MM
        label: parts.Name = "L"

    role = Role.GRID
    options: Options

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        options = self.options
        loads = [
            Load(f"{options.label}{number}", x_mm, y_mm, percent / 100, trial)
            for percent in options.strains_percent
            for trial in range(options.trials)
            for number, (x_mm, y_mm) in enumerate(options.locations_mm)
        ]
        yield from parts.presses(options, loads, hold_s=options.hold_s, rest_s=options.rest_s, context=context)


_PLACE_FORMS: Final = "a table of strain_percent with x_mm and y_mm, or with radius_mm and angle_deg"


class GivenLoad(PluginOptions):
    """One load: its strain and its place, in one of two forms."""

    strain_percent: parts.Strain
    x_mm: parts.Coordinate = 0.0
    y_mm: parts.Coordinate = 0.0
    radius_mm: Annotated[float, Field(ge=0, le=1e3)] | None = None
    angle_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0

    def place_mm(self) -> tuple[float, float]:
        if self.radius_mm is None:
            return self.x_mm, self.y_mm
        angle = radians(self.angle_deg)
        return round(self.radius_mm * cos(angle), 2) + 0.0, round(self.radius_mm * sin(angle), 2) + 0.0  # no −0


class GivenLoadsSequence(WithOptions):
    """Press a list of loads in its order, one or several times.

    Parameters
    ----------
    loads : tables of ``strain_percent`` and a place, which is either ``x_mm`` and ``y_mm``, or ``radius_mm`` and
        ``angle_deg`` (counterclockwise from the x axis), as the paper's Table 5 gives it. There is no default.
    trials : number of times that the list is pressed.
    hold_s : time pressed.
    rest_s : rest after each press.
    initial_rest_s : rest after surface finding.
    find_surface : whether the surface is found at every place first.
    unloaded_frames : number of unloaded frames before the first press.
    label : prefix of the labels.

    """

    class Options(parts.RestedOptions):
        loads: Annotated[tuple[GivenLoad, ...], Array, Field(min_length=1)]
        trials: parts.Times = 1
        hold_s: parts.Held = 60.0
        rest_s: parts.Rest = 60.0
        label: parts.Name = "R"

        def problems(self) -> Iterator[Problem]:
            """A load has one place."""
            for number, load in enumerate(self.loads):
                if load.model_fields_set - {"strain_percent"} not in ({"x_mm", "y_mm"}, {"radius_mm", "angle_deg"}):
                    what = f"has {', '.join(sorted(load.model_fields_set))}"
                    yield Problem(("loads", number), what, f"it must be {_PLACE_FORMS}")

    role = Role.RANDOM
    options: Options

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        options = self.options
        loads = [
            Load(f"{options.label}{number}", *load.place_mm(), load.strain_percent / 100, trial)
            for trial in range(options.trials)
            for number, load in enumerate(options.loads)
        ]
        yield from parts.presses(options, loads, hold_s=options.hold_s, rest_s=options.rest_s, context=context)


Radius = Annotated[float, Field(ge=0, le=1e3)]


class RandomLoadsSequence(WithOptions):
    """Seeded random loads R0, R1, …, uniform in radius, angle and strain (paper 3.3).

    The paper says radii of 0–40 % of the domain *radius*; its table reaches 35.8 mm of 50, so 40 % of the
    *diameter* is what was run, and the default here. Uniform in radius, not in area, as in the paper.

    Numbers come from a Philox stream keyed by (seed, ``stream``), three a load, so that a longer list begins
    with the shorter one and no other use of the seed changes them. Coordinates are cut towards zero to
    0.01 mm (a load never lies beyond the highest radius; it may lie up to 0.015 mm inside the lowest) and
    strains rounded to 0.01 %: what the report prints is what was done.

    Parameters
    ----------
    count : number of presses.
    radius_mm : [lowest, highest].
    strain_percent : [lowest, highest].
    hold_s : time pressed.
    rest_s : rest after each press.
    initial_rest_s : rest after surface finding.
    find_surface : whether the surface is found at every place first.
    unloaded_frames : number of unloaded frames before the first press.
    unloaded_before : an earlier phase took them: four are enough.
    stream : name of the random stream; two phases of one recipe draw different loads under different names.
    clearance_mm : travel height above the sheet; by default the hover height.
    residue_percent : rests end at this predicted residue at the next place, of its change.
    least_rest_s : shortest such rest.

    """

    class Options(parts.BriefOptions):
        count: Annotated[int, Field(ge=1, le=10_000)] = 10
        radius_mm: Annotated[tuple[Radius, Radius], Array, parts.Rising] = (0.0, 40.0)
        strain_percent: Annotated[tuple[parts.Strain, parts.Strain], Array, parts.Rising] = (5.0, 30.0)
        hold_s: parts.Held = 60.0
        rest_s: parts.Rest = 60.0
        stream: parts.Name = "random-loads"

    role = Role.RANDOM
    options: Options

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time for one seed."""
        options = self.options
        digest = hashlib.sha256(f"{context.seed}/{options.stream}".encode()).digest()
        generator = np.random.Generator(np.random.Philox(key=int.from_bytes(digest[:16], "big")))
        draws = generator.random((options.count, 3))
        loads = tuple(self._draw_load(number, *map(float, draw)) for number, draw in enumerate(draws))
        yield from parts.presses(options, loads, hold_s=options.hold_s, rest_s=options.rest_s, context=context)

    def _draw_load(self, number: int, radius_draw: float, angle_draw: float, strain_draw: float) -> Load:
        """Return a load of three random numbers, each from 0 to 1."""
        radius_mm = _interpolate(self.options.radius_mm, radius_draw)
        angle = 2 * np.pi * angle_draw
        place_mm = np.trunc(100 * radius_mm * np.array([np.cos(angle), np.sin(angle)])) / 100 + 0.0  # no −0
        lowest, highest = self.options.strain_percent
        percent = min(max(round(_interpolate((lowest, highest), strain_draw), 2), lowest), highest)
        return Load(f"R{number}", float(place_mm[0]), float(place_mm[1]), percent / 100, 0)


def _interpolate(bounds: tuple[float, float], share: float) -> float:
    lowest, highest = bounds
    return lowest + (highest - lowest) * share
