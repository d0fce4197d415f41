"""The emulated head: it moves in machine coordinates and strains the world's sheet."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from cbsr_qa.domain.plan.plan import Motion
from cbsr_qa.simulate.head import PressWriter
from cbsr_qa.simulate.instruments.streams import WatchedClock
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.system.clock import round_to_ticks

Position = tuple[float, float, float]

#: Position of the machine when switched on: beside its end stops, not where its firmware assumes.
_PARKED_MM: Final = (10.0, 10.0, 40.0)
_NEAR_MM: Final = 1e-6
#: A resumed session may begin at any millisecond, and make this many movements (as a power of two).
_MOVEMENTS_BITS: Final = 32


class Order(IntEnum):
    """Kinds of motion that a head at rest is ordered to make."""

    TRAVEL = 0
    DOWN = 1
    UP = 2


@dataclass(frozen=True, slots=True)
class _Way:
    """One straight motion at constant speed."""

    start_s: float
    end_s: float
    origin: Position
    goal: Position
    speed_mm_s: float

    def position(self, time_s: float) -> Position:
        path_share = 1.0 if time_s >= self.end_s else max(time_s - self.start_s, 0.0) / (self.end_s - self.start_s)
        x, y, z = (a + path_share * (b - a) for a, b in zip(self.origin, self.goal, strict=True))
        return self.goal if path_share == 1.0 else (x, y, z)


class EmulatedHead:
    """A head on three axes; commands queue motions, which happen as time passes on the clock.

    Speeds are constant: the time lost to acceleration at 200 mm/s² is left out, as in
    :mod:`cbsr_qa.domain.plan.steps`.

    Parameters
    ----------
    begin_order : called as a head at rest is ordered to move; returns the address of its position errors, or None to
        count on.
    """

    def __init__(
        self,
        clock: WatchedClock,
        world: SimulatedWorld,
        motion: Motion,
        begin_order: Callable[[Order], int | None],
    ) -> None:
        self._begin_order = begin_order
        self._clock = clock
        self._world = world
        self._hover_mm = motion.hover_mm
        self._centre_mm = (0.0, 0.0)
        self._hover_z_mm = 0.0
        self._upward = 1.0
        self._ways: deque[_Way] = deque()
        self._rests: Position = _PARKED_MM
        #: Number of sideways moves within the sheet: zero with a driver that lifts first.
        self.dragged = 0
        self._written = self._writer()
        clock.watch(self._follow)

    def mount_over(self, centre_mm: tuple[float, float], hover_z_mm: float, *, up: bool = True) -> None:
        """Set the sheet's position in machine coordinates.

        ``hover_z_mm``: machine z of the hover height.
        """
        self._centre_mm, self._hover_z_mm, self._upward = centre_mm, hover_z_mm, 1.0 if up else -1.0
        self._written = self._writer()

    @property
    def position_mm(self) -> Position:
        """Current position in machine coordinates."""
        now_s = self._clock.now()
        return next((way.position(now_s) for way in self._ways if way.start_s <= now_s < way.end_s), self._rests)

    @property
    def place_mm(self) -> tuple[float, float]:
        """Current position from the sheet's centre."""
        x, y, _ = self._sheet_position(self.position_mm)
        return x, y

    @property
    def height_mm(self) -> float:
        """Height above the nominal surface; negative in the sheet."""
        return -self._sheet_position(self.position_mm)[2]

    @property
    def touching(self) -> bool:
        x, y, depth_mm = self._sheet_position(self.position_mm)
        return self._above_sheet(x, y) and depth_mm > self._world.surface_mm(x, y, self._clock.now()) + _NEAR_MM

    @property
    def up(self) -> bool:
        """Whether it is at or above the hover height."""
        return self.height_mm >= self._hover_mm - 1e-3

    @property
    def moving(self) -> bool:
        return bool(self._ways)

    @property
    def queued(self) -> int:
        return len(self._ways)

    @property
    def free_at_s(self) -> float:
        """End of the last motion; at least now."""
        return self._ways[-1].end_s if self._ways else self._clock.now()

    @property
    def next_end_s(self) -> float:
        """End of the active motion; at least now."""
        return self._ways[0].end_s if self._ways else self._clock.now()

    @property
    def target_mm(self) -> Position:
        """Position after all motions."""
        return self._ways[-1].goal if self._ways else self._rests

    def go(self, goal: Position, speed_mm_s: float) -> None:
        """Queue a straight motion; a goal equal to its start is skipped."""
        origin, start_s = self.target_mm, self.free_at_s
        length_mm = math.dist(origin, goal)
        if length_mm <= _NEAR_MM:
            return
        if not self._ways and (first := self._begin_order(self._kind(origin, goal))) is not None:
            self._written.count_from(first)
        self._ways.append(_Way(start_s, start_s + round_to_ticks(length_mm / speed_mm_s), origin, goal, speed_mm_s))
        if len(self._ways) == 1:
            self._begin(self._ways[0])

    def stop(self) -> None:
        if self._ways:
            self._rests = self.position_mm
            self._written.halt(self._clock.now())
            self._ways.clear()

    def _kind(self, origin: Position, goal: Position) -> Order:
        if origin[:2] != goal[:2]:
            return Order.TRAVEL
        return Order.UP if (goal[2] - origin[2]) * self._upward > 0 else Order.DOWN

    def _writer(self) -> PressWriter:
        """Start a stroke from the head's position; a resumed session has different position errors."""
        first = math.ceil(1e3 * self._world.setting.began_s) << _MOVEMENTS_BITS
        return PressWriter(self._world, self._sheet_position(self._rests), first_index=first)

    def _follow(self, now_s: float) -> None:
        """Start the motions that are due; called after each advance of the clock."""
        while self._ways and self._ways[0].end_s <= now_s:
            self._rests = self._ways.popleft().goal
            if self._ways:
                self._begin(self._ways[0])

    def _begin(self, way: _Way) -> None:
        self._rests = way.goal
        origin, goal = self._sheet_position(way.origin), self._sheet_position(way.goal)
        if origin[:2] != goal[:2]:
            surface_mm = self._world.surface_mm(*origin[:2], way.start_s)
            self.dragged += self._above_sheet(*origin[:2]) and self._written.true[2] > surface_mm
            self._written.travel((*goal[:2], origin[2]), way.end_s)
        if origin[2] != goal[2] and self._above_sheet(*goal[:2]):
            self._written.stroke(goal, way.start_s, way.end_s - way.start_s, way.speed_mm_s)
        elif origin[2] != goal[2]:
            self._written.travel(goal, way.end_s)

    def _above_sheet(self, x_mm: float, y_mm: float) -> bool:
        outline = self._world.setting.sensor_type.outline
        return bool(outline.clearance_mm(np.array([[x_mm, y_mm]]))[0] >= 0)

    def _sheet_position(self, position: Position) -> Position:
        """Return place from the sheet's centre and depth below its nominal surface."""
        x, y, z = position
        height_mm = self._hover_mm + self._upward * (z - self._hover_z_mm)
        return x - self._centre_mm[0], y - self._centre_mm[1], -height_mm
