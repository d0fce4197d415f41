"""The simulated head: it travels in the station's time and leaves strain ramps under it."""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from cbsr_qa.clock import Clock, in_ticks
from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.kinematics import (
    CLEARANCE_MM,
    SEARCH_CONTACT_STEPS,
    SEARCH_DWELL_S,
    SEARCH_FROM_MM,
    SEARCH_STEP_MM,
)
from cbsr_qa.domain.plan import Motion
from cbsr_qa.simulate.press_writer import PressWriter, Sheet

_CONTACT_FORCE_N: Final = 0.2  # the rig's
_SEARCH_DEPTH_MM: Final = 1.0  # below the nominal surface; deeper than any seat is wrong


class SimulatedHead:
    """A head over a sheet. Depths are below the nominal surface, so that hovering is a negative depth.

    Every movement takes its time on the clock; where the head is below the true surface, the movement is written
    as a strain ramp into a press of its own.

    Parameters
    ----------
    clock : the station's.
    sheet : what it meets; presses are appended to its list.
    motion : the station's speeds and hover height.
    role : in the station file, for messages.
    first_index : of its movements, the addresses of their random numbers.

    Its movements take whole ticks of the clock, and so do the ramps they leave: see :mod:`cbsr_qa.clock`.
    """

    def __init__(self, clock: Clock, sheet: Sheet, motion: Motion, *, role: str, first_index: int = 0) -> None:
        self._role = role
        self._clock = clock
        self._motion = motion
        self._place = (0.0, 0.0)
        self._depth_mm = -motion.hover_mm
        self._written = PressWriter(sheet, (*self._place, self._depth_mm), first_index=first_index)
        self._speed_mm_s = motion.press_speed_mm_s
        self._found: dict[tuple[float, float], float] = {}
        self._free_at_s = 0.0

    def count_from(self, index: int) -> None:
        """Address the movements that follow from here on."""
        self._written.count_from(index)

    @property
    def place_mm(self) -> tuple[float, float]:
        """Where the head was told to go, from the sheet's centre."""
        return self._place

    def travel(self, x_mm: float, y_mm: float) -> None:
        """Go to a place at the hover height, lifting first if need be."""
        self.lift()
        self._clock.sleep(math.dist(self._place, (x_mm, y_mm)) / self._motion.travel_speed_mm_s)
        self._place = (x_mm, y_mm)
        self._written.travel((*self._place, self._depth_mm), self._clock.now())

    def press(self, depth_mm: float, speed_mm_s: float) -> None:
        """Go this far below the surface found here (or else found nearest, or else nominal)."""
        surface = self._surface_mm()
        self._speed_mm_s = speed_mm_s
        if self._depth_mm < surface - CLEARANCE_MM:
            self._go(surface - CLEARANCE_MM, self._motion.travel_speed_mm_s)
        self._go(surface + depth_mm, speed_mm_s)

    def lift(self) -> None:
        """Go up to the hover height: out of the sheet at the speed it was pressed with, then faster."""
        clear = self._surface_mm() - CLEARANCE_MM
        if self._depth_mm > clear:
            self._go(clear, self._speed_mm_s)
        self._go(-self._motion.hover_mm, self._motion.travel_speed_mm_s)

    def drop_everything(self) -> None:
        """Start lifting at the travel speed and return at once; the next movement waits until the head is up."""
        up_s = self._start(-self._motion.hover_mm, self._motion.travel_speed_mm_s)
        self._free_at_s = max(self._free_at_s, up_s)

    def find_surface(self, read_force_N: Callable[[float], float]) -> float:
        """Step down until the contact force, and extrapolate the force–depth line to zero.

        Parameters
        ----------
        read_force_N : mean force over this many seconds up to now.

        Returns
        -------
        Depth of the surface from the hover height [mm].

        Raises
        ------
        InstrumentError
            If there is no contact force down to the deepest point, or it does not rise with depth.
        """
        self.lift()
        depths, forces = self._search(read_force_N)
        self.lift()
        stiffness, offset = np.polyfit(depths, forces, 1)
        if stiffness <= 0:
            raise self._no_surface("the force does not rise with depth at the surface")
        self._found[self._place] = float(-offset / stiffness)
        return self._motion.hover_mm + self._found[self._place]

    def _search(self, read_force_N: Callable[[float], float]) -> tuple[list[float], list[float]]:
        """Step down past the contact force; return the last depths [mm] and their forces [N]."""
        motion = self._motion
        self._speed_mm_s = motion.press_speed_mm_s
        self._go(-SEARCH_FROM_MM, motion.travel_speed_mm_s)
        depths: list[float] = []
        forces: list[float] = []
        while sum(force >= _CONTACT_FORCE_N for force in forces) < SEARCH_CONTACT_STEPS:
            if self._depth_mm > _SEARCH_DEPTH_MM:
                self.lift()
                raise self._no_surface(
                    f"no contact force of {_CONTACT_FORCE_N:g} N down to {_SEARCH_DEPTH_MM:g} mm below nominal"
                )
            self._go(self._depth_mm + SEARCH_STEP_MM, motion.press_speed_mm_s)
            self._clock.sleep(SEARCH_DWELL_S)
            depths.append(self._depth_mm)
            forces.append(read_force_N(SEARCH_DWELL_S))
        return depths[-SEARCH_CONTACT_STEPS:], forces[-SEARCH_CONTACT_STEPS:]

    def _no_surface(self, reason: str) -> InstrumentError:
        x_mm, y_mm = self._place
        return InstrumentError(
            self._role,
            f"({x_mm:g}, {y_mm:g}) mm",
            reason,
            remedy="look whether a sheet is in place; a simulated one needs the effect 'elastic-stress'",
        )

    def _surface_mm(self) -> float:
        """Where the head takes the surface to be: found here, or else found nearest, or else nominal."""
        if not self._found:
            return 0.0
        return self._found[min(self._found, key=lambda place: math.dist(place, self._place))]

    def _go(self, depth_mm: float, speed_mm_s: float) -> None:
        self._clock.sleep(self._free_at_s - self._clock.now())
        self._clock.sleep(self._start(depth_mm, speed_mm_s) - self._clock.now())

    def _start(self, depth_mm: float, speed_mm_s: float) -> float:
        """Begin a movement now; the part of it below the true surface is written; return when it will be over."""
        start = self._clock.now()
        if depth_mm == self._depth_mm:
            return start  # told to stay, it does: no new error, no ramp of no length
        duration_s = in_ticks(abs(depth_mm - self._depth_mm) / speed_mm_s)
        self._depth_mm = depth_mm
        self._written.stroke((*self._place, depth_mm), start, duration_s, speed_mm_s)
        return start + duration_s
