"""The one world behind all emulated instruments: sheet, head, and how source and meter are wired to the pins."""

from dataclasses import dataclass

from cbsr_qa.domain.plan import Motion
from cbsr_qa.emulate.clock import WatchedClock
from cbsr_qa.emulate.head import EmulatedHead
from cbsr_qa.simulate.frames import SimulatedFrame
from cbsr_qa.simulate.world import SimulatedWorld


@dataclass(slots=True)
class Wiring:
    """What is connected to the sheet at the moment.

    Parameters
    ----------
    current_A : of the source; None while its output is off.
    limit_V : the source's voltage limit.
    reading_s : time the meter takes for one reading.
    drive, measure : pairs of the sensor type's pattern that the multiplexer connects.
    frame : counts the multiplexer's rounds; readings of one round belong to one frame.
    """

    current_A: float | None = None
    limit_V: float = 20.0
    reading_s: float = 1e-3
    drive: int = 0
    measure: int = 0
    frame: int = 0


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
        self.wiring = Wiring()
        # It watches the clock before any instrument does: what they say of a moment rests on where the head was.
        self.head = EmulatedHead(clock, world, motion)
        self._taken: tuple[int, SimulatedFrame] | None = None

    def frame(self) -> SimulatedFrame:
        """Readings of the multiplexer's present round, all of the moment in its middle [V at the scene's current].

        The sheet is solved once a round, when its first reading is taken.
        """
        number = self.wiring.frame
        if self._taken is None or self._taken[0] != number:
            drives, measures = self.world.setting.sensor_type.pattern.shape
            middle_s = self.clock.now() + drives * measures * self.wiring.reading_s / 2
            self._taken = (number, self.world.frame(middle_s, number))
        return self._taken[1]
