"""Presses of which the run decides one after the other, until the force of the calibration is good enough."""

from collections.abc import Iterator
from typing import Annotated, Final

from pydantic import AfterValidator, Field

from cbsr_qa.domain.readings.loads import sunflower_mm
from cbsr_qa.plugin import Array, Load, PressGoal, Problem, Role, SequenceContext, Step, WithOptions
from cbsr_qa_plugins.sequences import parts
from cbsr_qa_plugins.sequences.places import Radius

#: None are given where the places are those of the lattice.
Places = Annotated[tuple[Annotated[tuple[parts.Coordinate, parts.Coordinate], Array], ...], Array]
#: Fewest presses of a map.
_FEWEST: Final = 3


def _check_frames(count: int) -> int:
    if 0 < count < parts.UNLOADED_FRAMES:
        raise ValueError(f"it must be 0, or {parts.UNLOADED_FRAMES} or more")
    return count


FramesOrNone = Annotated[int, Field(ge=0, le=100_000), AfterValidator(_check_frames)]


class AdaptiveGridSequence(WithOptions):
    """Press, after each press, the place that reduces the expected error of force most for its time.

    It ends once the error, at the stated confidence, is at most the target, or after the most presses. The error is
    the root mean square over loads of every radius and strain within bounds; every listed place is checked before
    anything moves, and each is pressed at most once.

    Parameters
    ----------
    target_N : force error at which it ends. There is no default.
    confidence : probability with which the error is below the target.
    at_least : fewest presses; until then places are chosen as for a usual sheet.
    at_most : most presses.
    count, radius_mm : number of places on a sunflower lattice, and the radius of the lattice.
    locations_mm : [x, y] of each place, instead of the lattice.
    strain_percent : strain of the presses.
    hold_s : time pressed.
    rest_s : rest after each press.
    area_radius_mm : largest distance from the centre of the loads that matter.
    area_strain_percent : [lowest, highest] strain of the loads that matter.
    label : prefix of the labels.
    initial_rest_s : rest before the unloaded frames.
    find_surface : whether the surface is found at each place before it is pressed.
    unloaded_frames : number of unloaded frames before the first press; 0 where an earlier phase has taken them.
    unloaded_before, surface, touches_mm, surface_tolerance_mm, clearance_mm, drift, least_initial_rest_s : as of
        ``location-grid``.

    """

    class Options(parts.SurfaceOptions):
        unloaded_frames: FramesOrNone = parts.UNLOADED_FRAMES
        target_N: Annotated[float, Field(gt=0, le=1e3)]
        confidence: Annotated[float, Field(ge=0.5, le=0.99)] = 0.8
        at_least: Annotated[int, Field(ge=_FEWEST, le=1000)] = 6
        at_most: Annotated[int, Field(ge=_FEWEST, le=1000)] = 24
        count: Annotated[int, Field(ge=1, le=1000)] = 30
        radius_mm: Radius = 40.0
        locations_mm: Annotated[Places, parts.once("nothing")] = ()
        strain_percent: parts.Strain = 25.0
        hold_s: parts.Held = 60.0
        rest_s: parts.Rest = 60.0
        area_radius_mm: Radius = 40.0
        area_strain_percent: Annotated[tuple[parts.Strain, parts.Strain], Array, parts.Rising] = (5.0, 30.0)
        label: parts.Name = "A"

        def places_mm(self) -> tuple[tuple[float, float], ...]:
            return self.locations_mm or sunflower_mm(self.count, self.radius_mm)

        def problems(self) -> Iterator[Problem]:
            """Presses are at least as many as must be, and at most as many as there are places."""
            if self.at_most < self.at_least:
                yield Problem(("at_most",), f"is {self.at_most}", f"it must be at_least, {self.at_least} or more")
            if (places := len(self.places_mm())) < _FEWEST:
                where = "locations_mm" if self.locations_mm else "count"
                yield Problem(
                    (where,), f"gives {places} places", f"it must give {_FEWEST} or more: fewer make no map"
                )
            elif self.at_most > places:
                yield Problem(
                    ("at_most",), f"is {self.at_most}", f"it must be at most {places}, the number of places"
                )

    role = Role.GRID
    options: Options

    @property
    def goal(self) -> PressGoal:
        options = self.options
        lowest, highest = options.area_strain_percent
        return PressGoal(
            target_N=options.target_N,
            at_least=options.at_least,
            at_most=options.at_most,
            radius_mm=options.area_radius_mm,
            strains=(lowest / 100, highest / 100),
            confidence=options.confidence,
        )

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        options = self.options
        by_plane = options.surface == "plane"
        # Without a plane each surface is found when its place is pressed.
        yield from parts.prepare_sheet(options, options.places_mm() if by_plane else ())
        for number, (x_mm, y_mm) in enumerate(options.places_mm()):
            if options.find_surface and not by_plane:
                yield from parts.find_surfaces([(x_mm, y_mm)])
            load = Load(f"{options.label}{number}", x_mm, y_mm, options.strain_percent / 100, 0)
            yield from parts.press_cycle(load, hold_s=options.hold_s, rest_s=options.rest_s)
