"""The simulated head: it moves in station time and leaves strain ramps in the sheet."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.plan.plan import Motion
from cbsr_qa.domain.plan.steps import (
    CLEARANCE_MM,
    SEARCH_CONTACT_STEPS,
    SEARCH_DWELL_S,
    SEARCH_FROM_MM,
    SEARCH_STEP_MM,
)
from cbsr_qa.domain.plan.world import HeadPosition, SimulatedPress, StrainRamp
from cbsr_qa.system.clock import Clock, round_to_ticks


class Sheet(Protocol):
    """Surface that a head meets."""

    presses: list[SimulatedPress]

    def surface_mm(self, x_mm: float, y_mm: float, time_s: float) -> float:
        """Depth of the true surface below nominal [mm]."""
        ...

    def thickness_mm(self, x_mm: float, y_mm: float) -> float:
        """Thickness of the sheet [mm]."""
        ...

    def head_at(self, to: HeadPosition, before: HeadPosition, time_s: float, index: int) -> HeadPosition:
        """Place that the head reaches for a commanded place; the index counts its movements."""
        ...


@dataclass(frozen=True, slots=True)
class _Stroke:
    """The last true vertical movement."""

    start_s: float
    duration_s: float
    from_mm: float
    to_mm: float
    surface_mm: float


class PressWriter:
    """Tracks the true position of a head, and records presses below the true surface.

    Presses are appended to the sheet's list; their ramps begin and end on ticks of the clock where movements do.
    ``at`` is the initial place, and ``first_index`` the address of the first movement's random numbers.
    """

    def __init__(self, sheet: Sheet, at: HeadPosition, *, first_index: int = 0) -> None:
        self._sheet = sheet
        self._true = at
        self._movements = first_index
        self._pressing: SimulatedPress | None = None
        self._stroke: _Stroke | None = None

    @property
    def true(self) -> HeadPosition:
        """True place after the last movement."""
        return self._true

    def count_from(self, index: int) -> None:
        """Set the address of the movements that follow."""
        self._movements = index

    def travel(self, to: HeadPosition, time_s: float) -> None:
        self._true = self._arrival(to, time_s)

    def stroke(self, to: HeadPosition, start_s: float, duration_s: float, speed_mm_s: float) -> None:
        """Start to move up or down; the part below the true surface is recorded immediately."""
        x_mm, y_mm, true_mm = self._true
        surface = self._sheet.surface_mm(x_mm, y_mm, start_s)
        self._true = (x_mm, y_mm, self._arrival(to, start_s)[2])
        self._stroke = _Stroke(start_s, duration_s, true_mm, self._true[2], surface)
        start_depth_mm, end_depth_mm = max(true_mm - surface, 0.0), max(self._true[2] - surface, 0.0)
        if start_depth_mm != end_depth_mm:
            ramp_s = min(round_to_ticks(abs(end_depth_mm - start_depth_mm) / speed_mm_s), duration_s)
            begin_s = start_s if end_depth_mm < start_depth_mm else start_s + duration_s - ramp_s
            if self._pressing is None:
                self._pressing = SimulatedPress(len(self._sheet.presses), *self._true[:2])
                self._sheet.presses.append(self._pressing)
            strain = (end_depth_mm - start_depth_mm) / self._sheet.thickness_mm(x_mm, y_mm)
            self._pressing.steps.append(StrainRamp(begin_s, ramp_s, strain))
        if end_depth_mm == 0:
            self._pressing = None

    def halt(self, time_s: float) -> None:
        """Stop the head at a given time: the rest of its last stroke is discarded."""
        stroke, self._stroke = self._stroke, None
        if stroke is None or time_s >= stroke.start_s + stroke.duration_s:
            return
        x_mm, y_mm, _ = self._true
        way = max(time_s - stroke.start_s, 0.0) / stroke.duration_s
        depth_mm = stroke.from_mm + way * (stroke.to_mm - stroke.from_mm)
        press = self._cut(time_s) if max(stroke.from_mm, stroke.to_mm) > stroke.surface_mm else None
        strain = press.strain_at(time_s) if press is not None else 0.0
        if strain > 0:
            depth_mm = stroke.surface_mm + strain * self._sheet.thickness_mm(x_mm, y_mm)
        self._pressing = press if strain > 0 else None
        self._true = (x_mm, y_mm, depth_mm)

    def _cut(self, time_s: float) -> SimulatedPress:
        """Replace the last press by a new object that ends now, so references to the old one stay distinct."""
        old_press = self._sheet.presses[-1]
        steps = [_cut_ramp(step, time_s) for step in old_press.steps if step.start_s < time_s]
        new_press = SimulatedPress(old_press.index, old_press.x_mm, old_press.y_mm, steps)
        self._sheet.presses[-1] = new_press
        return new_press

    def _arrival(self, to: HeadPosition, time_s: float) -> HeadPosition:
        self._movements += 1
        return self._sheet.head_at(to, self._true, time_s, self._movements)


def _cut_ramp(step: StrainRamp, time_s: float) -> StrainRamp:
    """Return the part of a ramp before a time."""
    if time_s >= step.start_s + step.ramp_s:
        return step
    part = (time_s - step.start_s) / step.ramp_s
    return replace(step, ramp_s=part * step.ramp_s, change=part * step.change)


_CONTACT_FORCE_N: Final = 0.2  # the rig's
_SEARCH_DEPTH_MM: Final = 1.0  # below the nominal surface; a greater depth is always wrong


class SimulatedHead:
    """A head over a sheet. Depths are below the nominal surface, so that hovering is a negative depth.

    Every movement takes whole ticks of the clock; the part below the true surface is appended to the sheet's presses
    as a strain ramp. ``first_index`` is the address of the first movement's random numbers.
    """

    def __init__(self, clock: Clock, sheet: Sheet, motion: Motion, *, role: str, first_index: int = 0) -> None:
        self._role = role
        self._clock = clock
        self._motion = motion
        self._place = (0.0, 0.0)
        self._depth_mm = self._up_mm = -motion.hover_mm
        self._written = PressWriter(sheet, (*self._place, self._depth_mm), first_index=first_index)
        self._speed_mm_s = motion.press_speed_mm_s
        self._found: dict[tuple[float, float], float] = {}
        self._free_at_s = 0.0

    def count_from(self, index: int) -> None:
        self._written.count_from(index)

    @property
    def place_mm(self) -> tuple[float, float]:
        """Commanded place, from the sheet's centre."""
        return self._place

    def travel(self, x_mm: float, y_mm: float) -> None:
        """Move to a place at the hover height, lifting first if needed."""
        self.lift()
        self._clock.sleep(math.dist(self._place, (x_mm, y_mm)) / self._motion.travel_speed_mm_s)
        self._place = (x_mm, y_mm)
        self._written.travel((*self._place, self._depth_mm), self._clock.now())

    def expect_surface(self, x_mm: float, y_mm: float, depth_mm: float) -> None:
        """Take the surface at a place as this far below the hover height."""
        self._found[(x_mm, y_mm)] = depth_mm - self._motion.hover_mm

    def lower_hover(self, by_mm: float) -> None:
        """Lift and travel this far below the hover height from now on."""
        self._up_mm = by_mm - self._motion.hover_mm

    def press(self, depth_mm: float, speed_mm_s: float) -> None:
        """Move to a depth below the surface found here (or else the nearest found, or else nominal)."""
        surface = self._surface_mm()
        self._speed_mm_s = speed_mm_s
        if self._depth_mm < surface - CLEARANCE_MM:
            self._move(surface - CLEARANCE_MM, self._motion.travel_speed_mm_s)
        self._move(surface + depth_mm, speed_mm_s)

    def lift(self) -> None:
        """Move to the hover height: out of the sheet at the speed of the press, then faster."""
        clear = self._surface_mm() - CLEARANCE_MM
        if self._depth_mm > clear:
            self._move(clear, self._speed_mm_s)
        self._move(self._up_mm, self._motion.travel_speed_mm_s)

    def drop_everything(self) -> None:
        """Start lifting at the travel speed and return; the next movement waits for the lift."""
        up_s = self._start(-self._motion.hover_mm, self._motion.travel_speed_mm_s)
        self._free_at_s = max(self._free_at_s, up_s)

    def approach(self) -> None:
        """Go down to where the search for the surface begins."""
        self.lift()
        self._speed_mm_s = self._motion.press_speed_mm_s
        self._move(-SEARCH_FROM_MM, self._motion.travel_speed_mm_s)

    def find_surface(self, read_force_N: Callable[[float], float]) -> float:
        """Step down until the contact force, and extrapolate the force–depth line to zero; the head has approached.

        Returns depth of the surface from the hover height [mm]. InstrumentError if there is no contact force down to
        the deepest point, or it does not rise with depth.
        """
        depths, forces = self._search(read_force_N)
        self.lift()
        stiffness, offset = np.polyfit(depths, forces, 1)
        if stiffness <= 0:
            raise self._surface_error("the force does not rise with depth at the surface")
        self._found[self._place] = float(-offset / stiffness)
        return self._motion.hover_mm + self._found[self._place]

    def _search(self, read_force_N: Callable[[float], float]) -> tuple[list[float], list[float]]:
        """Step down past the contact force; return the last depths [mm] and their forces [N]."""
        depths: list[float] = []
        forces: list[float] = []
        while sum(force >= _CONTACT_FORCE_N for force in forces) < SEARCH_CONTACT_STEPS:
            if self._depth_mm > _SEARCH_DEPTH_MM:
                self.lift()
                raise self._surface_error(
                    f"no contact force of {_CONTACT_FORCE_N:g} N down to {_SEARCH_DEPTH_MM:g} mm below nominal"
                )
            self._move(self._depth_mm + SEARCH_STEP_MM, self._motion.press_speed_mm_s)
            self._clock.sleep(SEARCH_DWELL_S)
            depths.append(self._depth_mm)
            forces.append(read_force_N(SEARCH_DWELL_S))
        return depths[-SEARCH_CONTACT_STEPS:], forces[-SEARCH_CONTACT_STEPS:]

    def _surface_error(self, reason: str) -> InstrumentError:
        x_mm, y_mm = self._place
        return InstrumentError(
            self._role,
            f"({x_mm:zg}, {y_mm:zg}) mm",
            reason,
            remedy="check whether a sheet is in place; a simulated one needs the effect 'elastic-stress'",
        )

    def _surface_mm(self) -> float:
        """Assumed height of the surface: found here, or else the nearest found, or else nominal."""
        if not self._found:
            return 0.0
        return self._found[min(self._found, key=lambda place: math.dist(place, self._place))]

    def _move(self, depth_mm: float, speed_mm_s: float) -> None:
        self._clock.sleep(self._free_at_s - self._clock.now())
        self._clock.sleep(self._start(depth_mm, speed_mm_s) - self._clock.now())

    def _start(self, depth_mm: float, speed_mm_s: float) -> float:
        """Start a movement now; the part below the true surface is recorded; return its end."""
        start = self._clock.now()
        if depth_mm == self._depth_mm:
            return start  # commanded to stay, it does: no new error, no ramp of zero length
        duration_s = round_to_ticks(abs(depth_mm - self._depth_mm) / speed_mm_s)
        self._depth_mm = depth_mm
        self._written.stroke((*self._place, depth_mm), start, duration_s, speed_mm_s)
        return start + duration_s
