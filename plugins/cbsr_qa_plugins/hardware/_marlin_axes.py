"""Three axes of a Marlin printer: position, monitored motions, and stopping."""

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Final

from cbsr_qa.plugin import CbsrError, InstrumentError
from cbsr_qa.system.clock import Clock
from cbsr_qa_plugins.hardware._marlin_link import MarlinLink

Position = tuple[float, float, float]

_NUMBER: Final = r"\s*(-?\d+(?:\.\d+)?)"
_REPORT: Final = re.compile(
    rf"^X:{_NUMBER}\s+Y:{_NUMBER}\s+Z:{_NUMBER}.*\bCount\s+X:{_NUMBER}\s+Y:{_NUMBER}\s+Z:{_NUMBER}"
)
#: Interval of position queries during motion [s].
POLL_S: Final = 0.1
#: What is left of a motion below this is over: a few ticks of the clock [s].
_OVER_S: Final = 1e-5
#: Tolerance of a reached position: firmware reports positions to 0.01 mm.
_THERE_MM: Final = 0.05
#: Allowed deviation of reported positions from the path.
_ASTRAY_MM: Final = 1.0
#: How long to wait for a thread that hangs on the line before bypassing it [s, real time].
_PATIENCE_S: Final = 0.25
_REPORTS: Final = 3
#: No count of restarts is this: it was homed once, and its position is lost.
_NOWHERE: Final = -1


@dataclass(frozen=True, slots=True)
class MachineFrame:
    """How the sheet lies in the machine.

    Parameters
    ----------
    upward : 1 where z grows upwards, -1 where it grows downwards.
    per_mm : what ``Count`` says in, per axis: 1 for millimetres, else steps per mm.
    """

    centre_mm: tuple[float, float]
    hover_z_mm: float
    hover_mm: float
    upward: int
    per_mm: Position
    acceleration_mm_s2: float

    def position(self, x_mm: float, y_mm: float, depth_mm: float) -> Position:
        """Return machine coordinates of a place from the sheet's centre and a depth below its nominal surface."""
        z = self.hover_z_mm - self.upward * (self.hover_mm + depth_mm)
        return self.centre_mm[0] + x_mm, self.centre_mm[1] + y_mm, z

    def depth_mm(self, z: float) -> float:
        return self.upward * (self.hover_z_mm - z) - self.hover_mm


class MarlinAxes:
    """Moves a head in machine coordinates.

    The position is known from homing to the next restart of the printer, and nothing moves without it but upwards.

    Parameters
    ----------
    machine : where the sheet lies in it.
    lift_mm_s : speed at which it goes up where it must.
    """

    def __init__(
        self,
        link: MarlinLink,
        machine: MachineFrame,
        clock: Clock,
        *,
        lift_mm_s: float,
        fail: Callable[[str, str], InstrumentError],
    ) -> None:
        self._link = link
        self.machine = machine
        self._clock = clock
        self._lift_mm_s = lift_mm_s
        self._fail = fail
        self._homed_at: int | None = None
        self._lifted_at: int | None = None
        self._position: Position | None = None  # confirmed position; None until checked
        self._stops = 0
        self._allowed_stops = 0

    @property
    def ever_homed(self) -> bool:
        return self._homed_at is not None

    @property
    def homed(self) -> bool:
        return self._homed_at == self._link.restarts

    def check_homed(self) -> None:
        """Raise InstrumentError where the position is not known."""
        if not self.homed:
            lost = "its position is lost: it has restarted, or did not end homing"
            lost = lost if self.ever_homed else "it has not homed yet"
            raise self._fail(lost, "home it before it moves; see that the head is clear of the sheet")

    def begin(self) -> None:
        """Begin something new: stops until now were meant for what was done before."""
        self._allowed_stops = self._stops

    def home(self) -> None:
        """Find the end stops: first upwards, out of a sheet the head may be in."""
        if self._link.down:
            self._link.reopen()
        self._position = None
        for line in self._lifting():
            self._link.command(line)
        self._lifted_at = self._link.restarts
        self._link.command("M400")
        self._link.command("G21")
        self._link.command("G90")
        a = self.machine.acceleration_mm_s2
        self._link.command(f"M201 X{a:g} Y{a:g} Z{a:g}")
        self._link.command(f"M204 P{a:g} T{a:g}")
        # Until it has answered the position is unknown: a stop during homing leaves axes that have not homed.
        self._homed_at, self._lifted_at = _NOWHERE, None
        # Named axes: a plain G28 levels the mesh as well on a Prusa, tapping where the sheet lies.
        self._link.command("G28 X Y Z")
        self._check_not_stopped()
        self._homed_at, self._position = self._link.restarts, None

    def final_position(self) -> Position:
        """Return the position after all motions; target and live position must agree."""
        if self._position is None:
            self._link.command("M400")
            target, live = self._report()
            if math.dist(target, live) > _THERE_MM:
                raise self._fail(f"it stands at {_words(live)} and means to be at {_words(target)}", _LOOK)
            self._position = live
        return self._position

    def live(self) -> Position:
        """Return the present position."""
        return self._report()[1]

    def go(self, goal: Position, speed_mm_s: float, look: Callable[[Position], None]) -> None:
        """Move in a straight line; returns when there.

        InstrumentError if the position is lost, the head does not get there, or it was stopped meanwhile. ``look``:
        called with the live position while it moves; what it raises stops and lifts the head.
        """
        self.check_homed()
        origin = self.final_position()
        length_mm = math.dist(origin, goal)
        if length_mm < 1e-4:
            return
        end_s = self._send_off(goal, speed_mm_s) + length_mm / speed_mm_s
        while (left_s := end_s - self._clock.now()) > _OVER_S:
            self._clock.sleep(min(left_s, POLL_S))
            self._check_not_stopped()
            live = self._on_the_way(origin, goal)
            with self.lifting_on_error():
                look(live)
        self._link.command("M400")
        self._check_arrived(goal)
        self._position = goal

    def stop_and_lift(self) -> None:
        """Stop at once and begin to lift; returns before the head is up. May be called from any thread, repeatedly.

        Where the position is known the head goes to its hover height. Where it is lost, it goes up by as much, once:
        that is out of the sheet from wherever it was, and further up is not known to be free. InstrumentError if the
        printer does not say that it does.
        """
        self._stops += 1
        self._position = None
        with self._link.alone(_PATIENCE_S) as mine:
            if not mine:
                self._link.shout(*self._stopping())
                raise self._fail("it was told to stop and lift, and did not answer: another command hangs", _LOOK)
            if self._link.down:
                self._link.reopen()
            if self._link.silent:
                # At once: asking it four times would leave the head in the sheet for as long.
                self._link.shout(*self._stopping())
                raise self._fail("it was told to stop and lift, and does not answer any more", _LOOK)
            restarts = self._link.restarts
            try:
                self._stop_and_lift()
            except InstrumentError:
                if self._link.restarts == restarts:
                    # It may receive commands without answering; a lift to a known height can be sent twice.
                    self._link.shout(*self._stopping())
                    raise
                self._stop_and_lift()  # it has restarted in between: now upwards from wherever it is

    @contextmanager
    def lifting_on_error(self) -> Iterator[None]:
        """Stop and lift where something is found wrong; what was found is what must be known."""
        try:
            yield
        except CbsrError:
            with suppress(InstrumentError):
                self.stop_and_lift()
            raise

    def _stop_and_lift(self) -> None:
        lines = self._stopping()
        self._position = None
        for line in lines or ["M114"]:  # without commands, it must still answer
            self._link.command(line)
        self._lifted_at = self._link.restarts

    def _stopping(self) -> list[str]:
        """Lines that stop and lift.

        None if its position is lost and a lift was already sent: a stop would leave it at an unknown height, perhaps
        still in the sheet.
        """
        lifts_already = not self.homed and self._lifted_at == self._link.restarts
        return [] if lifts_already else ["M410", *self._lifting()]

    def _lifting(self) -> list[str]:
        feed = f"F{60 * self._lift_mm_s:.6g}"
        if self.homed:
            return ["G90", f"G1 Z{self.machine.hover_z_mm:.4f} {feed}"]
        if self._lifted_at == self._link.restarts:
            return []
        return ["G91", f"G1 Z{self.machine.upward * self.machine.hover_mm:.4f} {feed}", "G90"]

    def _send_off(self, goal: Position, speed_mm_s: float) -> float:
        """Queue a motion; return when it began."""
        x, y, z = goal
        with self._link.alone(2 * _PATIENCE_S) as mine:
            if not mine:
                raise self._fail("another command hangs", _LOOK)
            self._check_not_stopped()
            began_s = self._clock.now()
            self._position = None
            self._link.command(f"G1 X{x:.4f} Y{y:.4f} Z{z:.4f} F{60 * speed_mm_s:.6g}")
        return began_s

    def _check_not_stopped(self) -> None:
        if self._stops != self._allowed_stops:
            raise self._fail("it was stopped on its way", "nothing: the bench was stopped")

    def _on_the_way(self, origin: Position, goal: Position) -> Position:
        """Return the live position; one off the path is queried again, since digits may be garbled."""
        for _ in range(2):
            live = self.live()
            length = math.dist(origin, live) + math.dist(live, goal)
            if length <= math.dist(origin, goal) + 2 * _ASTRAY_MM:
                return live
        raise self._fail(f"it is at {_words(live)}, off its way from {_words(origin)} to {_words(goal)}", _LOOK)

    def _check_arrived(self, goal: Position) -> None:
        for _ in range(2):
            target, live = self._report()
            if math.dist(live, goal) <= _THERE_MM and math.dist(target, goal) <= _THERE_MM:
                return
        raise self._fail(f"it stands at {_words(live)} and was told to go to {_words(goal)}", _LOOK)

    def _report(self) -> tuple[Position, Position]:
        for _ in range(_REPORTS):
            for line in self._link.query("M114"):
                if match := _REPORT.match(line):
                    x, y, z, *count = map(float, match.groups())
                    live = [c / per for c, per in zip(count, self.machine.per_mm, strict=True)]
                    return (x, y, z), (live[0], live[1], live[2])
        raise self._fail("it does not report its position", "check 'firmware' in its table, and its cable")


_LOOK: Final = "look whether the head is clear of the sheet before anything else is done"


def _words(position: Position) -> str:
    return f"({', '.join(f'{coordinate:.2f}' for coordinate in position)}) mm"
