"""The sheet's surface as a run knows it: the places found, the plane through them, and how high the head travels."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.plan import Motion
from cbsr_qa.domain.plan.steps import (
    CLEARANCE_MM,
    LEAST_SPREAD_MM,
    SEARCH_FROM_MM,
    FindSurface,
    TouchPlane,
    spread_mm,
)
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.plugin.instruments import GuidedApplicator, Sampler
from cbsr_qa.station.bench import FORCE_CHANNEL

#: Steepest plane that a stage can have: 0.8 mm over 40 mm, about what the surface search looks at.
_MOST_TILT: Final = 0.02
#: Forces that tell where contact was: the first ones above that of the surface search.
_CONTACT_N: Final = 0.15
_CONTACT_SAMPLES: Final = 5

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Plane:
    """Depth of a surface below the hover height: level at the centre [mm], slopes along x and y."""

    level_mm: float
    slope: Place

    def depth_mm(self, place_mm: Place) -> float:
        return self.level_mm + self.slope[0] * place_mm[0] + self.slope[1] * place_mm[1]

    @property
    def tilt(self) -> float:
        """Steepest slope [mm per mm]."""
        return math.hypot(*self.slope)


def fit_plane(depths_mm: dict[Place, float], tolerance_mm: float) -> Plane:
    """Fit a plane to the depths of a surface at three or more places, by least squares.

    Raises
    ------
    InstrumentError
        If the places lie in a line, the plane is steeper than a stage can be, or a place is off it by more than the
        tolerance.
    """
    places = list(depths_mm)
    if spread_mm(places) < LEAST_SPREAD_MM:
        raise _make_line_error(places)
    columns = np.column_stack([np.ones(len(places)), np.array(places)])
    depths = np.array(list(depths_mm.values()))
    level, along_x, along_y = np.linalg.lstsq(columns, depths)[0].tolist()
    plane = Plane(level, (along_x, along_y))
    if plane.tilt > _MOST_TILT:
        raise _make_plane_error(
            f"it is tilted by {100 * plane.tilt:.2g} mm over 100 mm; a stage is by {100 * _MOST_TILT:g} mm at most",
            "see that the sheet lies flat, and that no touch met its edge or a cable",
        )
    off_mm: Array = np.abs(columns @ [level, along_x, along_y] - depths)
    if off_mm.max() > tolerance_mm:
        x, y = places[int(off_mm.argmax())]
        raise _make_plane_error(
            f"the surface at ({x:zg}, {y:zg}) mm is {off_mm.max():.2g} mm off it; surface_tolerance_mm is"
            f" {tolerance_mm:g}",
            'press this sheet with surface = "each"',
        )
    return plane


def contact_depth_mm(samples: SampleBlock, down_s: float, depth_mm: float, speed_mm_s: float) -> float | None:
    """Depth at which a press met the sheet: where the line through its first forces is zero [mm].

    The head goes down at its press speed from shortly above the surface, and is at ``depth_mm`` at ``down_s``. None
    with fewer than two forces of contact.
    """
    depths = depth_mm - speed_mm_s * (down_s - samples.time_s)
    before = samples.values[depths < -CLEARANCE_MM / 2]
    forces = samples.values - (before.mean() if len(before) else 0.0)
    (met,) = np.nonzero((forces >= _CONTACT_N) & (depths > -1.0) & (depths <= depth_mm))
    first = met[:_CONTACT_SAMPLES]
    if len(first) < 2:
        return None
    stiffness, offset = np.polyfit(depths[first], forces[first], 1)
    return float(-offset / stiffness) if stiffness > 0 else None


class SheetSurface:
    """Surfaces found in a session of a run, and the plane through them once three places of it were touched.

    Parameters
    ----------
    reach_mm : farthest that the head's edge comes from the centre.
    """

    def __init__(self, applicator: GuidedApplicator, motion: Motion, reach_mm: float) -> None:
        self._applicator, self._motion, self._reach_mm = applicator, motion, reach_mm
        self.forget()

    def forget(self) -> None:
        """Know nothing, as after homing."""
        self._found: dict[Place, float] = {}
        self._found_again: set[Place] = set()
        self._touches: list[Place] = []
        self._plane: Plane | None = None
        self._tolerance_mm = 0.0
        self._clearance_mm: float | None = None
        self._late_mm: list[float] = []

    def add(self, touch: FindSurface, depth_mm: float) -> None:
        """Note a surface that was found; fit the plane if this touch is one of it.

        Raises
        ------
        InstrumentError
            If the touches give no plane.
        """
        self._found[(touch.x_mm, touch.y_mm)] = depth_mm
        if isinstance(touch, TouchPlane):
            self._touches.append((touch.x_mm, touch.y_mm))
            self._tolerance_mm = touch.tolerance_mm
            if spread_mm(self._touches) >= LEAST_SPREAD_MM:
                flat = {place: depth for place, depth in self._found.items() if place not in self._found_again}
                self._plane = fit_plane(flat, touch.tolerance_mm)
        self._set_hover()

    def correct(self, place_mm: Place, depth_mm: float) -> None:
        """Note a surface that was found again where the plane was wrong; the plane stays as it is."""
        self._found_again.add(place_mm)
        self._found[place_mm] = depth_mm

    def lower_hover(self, clearance_mm: float | None) -> None:
        """Travel this far above the highest point that the surface may have; None: at the hover height."""
        self._clearance_mm = clearance_mm
        self._set_hover()

    def _set_hover(self) -> None:
        if self._clearance_mm is None:
            self._applicator.lower_hover(0.0)
            return
        if self._plane is not None:
            highest_mm = self._plane.level_mm - self._plane.tilt * self._reach_mm
        else:  # the search begins this far above nominal: no surface is higher
            highest_mm = min([*self._found.values(), self._motion.hover_mm - SEARCH_FROM_MM])
        self._applicator.lower_hover(max(highest_mm - self._clearance_mm, 0.0))

    def expect(self, place_mm: Place) -> None:
        """Tell the applicator the plane's surface at a place where none was found.

        Raises
        ------
        InstrumentError
            If the places touched do not span a plane.
        """
        if self._touches and self._plane is None:
            raise _make_line_error(self._touches)
        if self._plane is not None and place_mm not in self._found:
            self._applicator.expect_surface(*place_mm, self._plane.depth_mm(place_mm))

    def contact_mm(self, samplers: Iterable[Sampler], began_s: float, down_s: float, depth_mm: float) -> float | None:
        """Depth below the expected surface at which a press met the sheet [mm]; None where too few forces tell."""
        force = next((sampler for sampler in samplers if sampler.channel == FORCE_CHANNEL), None)
        if self._plane is None or force is None:
            return None
        speed_mm_s = self._motion.press_speed_mm_s
        return contact_depth_mm(force.samples_since(began_s), down_s, depth_mm, speed_mm_s)

    def check_contact(self, place_mm: Place, contact_mm: float | None) -> str:
        """Why a press at a place of the plane did not meet the sheet where it should; empty if it did.

        The force lags behind the depth; presses at places that were found tell by how much.

        Parameters
        ----------
        contact_mm : depth below the expected surface at which the force began; None where too few samples tell.
        """
        if self._plane is None:
            return ""
        if place_mm in self._found:
            if contact_mm is not None:
                self._late_mm.append(contact_mm)
            return ""
        where = f"the press at ({place_mm[0]:zg}, {place_mm[1]:zg}) mm"
        if contact_mm is None:
            return f"too few forces tell where {where} met the sheet: its surface is found"
        off_mm = contact_mm - (float(np.mean(self._late_mm)) if self._late_mm else 0.0)
        if abs(off_mm) <= self._tolerance_mm:
            return ""
        side = "below" if off_mm > 0 else "above"
        return f"{where} met the sheet {abs(off_mm):.2f} mm {side} the plane: its surface is found again"


def _make_line_error(places_mm: Sequence[Place]) -> InstrumentError:
    where = ", ".join(f"({x:zg}, {y:zg})" for x, y in places_mm)
    return _make_plane_error(f"the places {where} mm lie in a line", "touch three places that do not")


def _make_plane_error(reason: str, remedy: str) -> InstrumentError:
    return InstrumentError("force_applicator", "the sheet's surface", f"it is no plane: {reason}", remedy=remedy)
