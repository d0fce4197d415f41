"""The one world behind all emulated instruments: sheet, head, and how source and meter are wired to the pins."""

import math
from dataclasses import dataclass
from typing import Final

from cbsr_qa.domain.plan import Motion
from cbsr_qa.emulate.clock import WatchedClock
from cbsr_qa.emulate.head import EmulatedHead
from cbsr_qa.simulate.frames import SimulatedFrame
from cbsr_qa.simulate.world import SimulatedWorld

#: More rounds than a session has.
_ROUNDS_BITS: Final = 32
#: A round that takes so many times as long as expected was broken off.
_LATEST_ROUNDS: Final = 3.0


@dataclass(slots=True)
class Wiring:
    """What is connected to the sheet at the moment.

    Parameters
    ----------
    current_A : of the source; None while its output is off.
    limit_V : the source's voltage limit.
    reading_s : time from one reading to the next, as it was last.
    drive, measure : pairs of the sensor type's pattern that the multiplexer connects.
    frame : counts the multiplexer's rounds; readings of one round belong to one frame.
    """

    current_A: float | None = None
    limit_V: float = 20.0
    reading_s: float = 1e-3
    drive: int = 0
    measure: int = 0
    frame: int = 0


@dataclass(frozen=True, slots=True)
class Electrical:
    """What is between source, sheet and meter at the moment.

    Parameters
    ----------
    volts : between the measured pair.
    current_A : through the driven pair.
    limited : whether the source is at its voltage limit.
    """

    volts: float
    current_A: float
    limited: bool


class EmulatedRig:
    """A simulated world that emulated instruments share.

    The world moves on by commands, never by the computer's time: an instrument that takes time for a command sleeps
    on the clock, and whoever waits on it moves everything on. Every access holds :attr:`lock`.

    Parameters
    ----------
    clock : the station's.
    world : the simulated sheet; its scene says at which current its readings are.
    motion : the station's hover height.
    """

    def __init__(self, clock: WatchedClock, world: SimulatedWorld, motion: Motion) -> None:
        self.clock = clock
        self.lock = clock.lock
        self.world = world
        self.motion = motion
        # Rounds count on from elsewhere in a session that goes on with a run: their noise is addressed by the count.
        self.wiring = Wiring(frame=math.ceil(1e3 * world.setting.began_s) << _ROUNDS_BITS)
        # It watches the clock before any instrument does: what they say of a moment rests on where the head was.
        self.head = EmulatedHead(clock, world, motion)
        self._taken: tuple[int, float, SimulatedFrame] | None = None

    def electrical(self) -> Electrical:
        """Ohm's law: what the source is told to give flows, or what its voltage limit drives through the sheet."""
        wiring = self.wiring
        if wiring.current_A is None:
            return Electrical(0.0, 0.0, limited=False)
        frame, at = self.frame(), (wiring.drive, wiring.measure)
        ohm = float(frame.drive_ohm[at])
        limited = abs(wiring.current_A) * ohm > wiring.limit_V
        flowing_A = math.copysign(wiring.limit_V / ohm, wiring.current_A) if limited else wiring.current_A
        per_ampere = float(frame.voltages[at]) / float(frame.current_A[at])
        return Electrical(per_ampere * flowing_A, flowing_A, limited)

    def frame(self) -> SimulatedFrame:
        """Readings of the multiplexer's present round, all of the moment in its middle [V at the scene's current].

        The sheet is solved once a round, when its first reading is taken; and again for what is left of a round that
        was broken off and is gone on with much later.
        """
        number, now_s = self.wiring.frame, self.clock.now()
        if self._taken is None or self._taken[0] != number or now_s > self._taken[1]:
            drives, measures = self.world.setting.sensor_type.pattern.shape
            half_s = drives * measures * self.wiring.reading_s / 2
            stale_s = now_s + _LATEST_ROUNDS * 2 * half_s
            self._taken = (number, stale_s, self.world.frame(now_s + half_s, number))
        return self._taken[2]
