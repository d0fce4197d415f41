"""The world behind all emulated instruments, and the start of those of a station."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, Final, Self

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.plan import EMULATED, InstrumentSpec, Motion
from cbsr_qa.plugin.hooks import Emulator
from cbsr_qa.simulate.frames import SimulatedFrame
from cbsr_qa.simulate.instruments.head import EmulatedHead, Order
from cbsr_qa.simulate.instruments.streams import Fault, FreeRunning, Port, PtyPort, Served, TcpPort, WatchedClock
from cbsr_qa.simulate.streams import first_address, step_act
from cbsr_qa.simulate.world import SimulatedWorld

#: More rounds than in any session.
_ROUNDS_BITS: Final = 32
#: A step has at most so many orders to the head of one kind.
_ORDERS: Final = 1 << 10
#: A round that takes so many times longer than expected was interrupted.
_LATEST_ROUNDS: Final = 3.0


@dataclass(slots=True)
class Wiring:
    """Current connections to the sheet.

    Parameters
    ----------
    current_A : current of the source; None while its output is off.
    reading_s : last time between two readings.
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
    """Current electrical circuit of source, sheet and meter."""

    volts: float
    current_A: float
    limited: bool


class EmulatedRig:
    """The simulated world shared by emulated instruments.

    Time in the world advances by commands, never by the computer's time: an instrument that takes time for a command
    sleeps on the clock, which advances everything. Every access holds :attr:`lock`. ``world``: the simulated sheet;
    its scene gives the current of its readings.
    """

    def __init__(self, clock: WatchedClock, world: SimulatedWorld, motion: Motion) -> None:
        self.clock = clock
        self.lock = clock.lock
        self.world = world
        self.motion = motion
        # Before the first step, rounds of a session that resumes a run are counted from another start: their noise is
        # addressed by the count.
        self.wiring = Wiring(frame=math.ceil(1e3 * world.setting.began_s) << _ROUNDS_BITS)
        # Watches the clock before any instrument does: their readings depend on where the head was.
        self.head = EmulatedHead(clock, world, motion, self._begin_order)
        self._taken: tuple[int, float, SimulatedFrame] | None = None
        self._step: int | None = None
        self._orders = dict.fromkeys(Order, 0)
        self._counting: list[Callable[[int], None]] = []

    def begin_step(self, phase: int, number: int) -> None:
        """Address random numbers by this step from here on, and by the head's orders in it.

        A step that is done again in another session then gives the numbers it would have given at first. A frame's
        middle is told from the time of its readings as stated until some of this step were taken.
        """
        with self.lock:
            setting = self.world.setting
            self.wiring.reading_s = setting.frame_period_s / math.prod(setting.sensor_type.pattern.shape)
            self._step = step_act(phase, number)
            self._orders = dict.fromkeys(Order, 0)
            self._count_from(first_address(self._step))

    def count_with(self, count_from: Callable[[int], None]) -> None:
        """Add a function that is called with the first address as a step, or an order to the head, begins."""
        self._counting.append(count_from)

    def _begin_order(self, order: Order) -> int | None:
        """Begin an order to a head at rest; return the first address of its numbers, or None before the first step.

        Orders are counted by their kind, those down since the last travel: a head that starts from elsewhere may need
        no travel, or must come to the hover height first.
        """
        if self._step is None:
            return None
        if order is Order.TRAVEL:
            self._orders[Order.DOWN] = 0
        self._orders[order] += 1
        first = first_address(self._step + order * _ORDERS + self._orders[order])
        self._count_from(first)
        return first

    def _count_from(self, first: int) -> None:
        self.wiring.frame = first
        for count_from in self._counting:
            count_from(first)

    def electrical(self) -> Electrical:
        """Apply Ohm's law: the commanded current flows, or the one limited by the voltage limit."""
        wiring = self.wiring
        if wiring.current_A is None:
            return Electrical(0.0, 0.0, limited=False)
        frame, channel = self.frame(), (wiring.drive, wiring.measure)
        ohm = float(frame.drive_ohm[channel])
        is_limited = abs(wiring.current_A) * ohm > wiring.limit_V
        flowing_A = math.copysign(wiring.limit_V / ohm, wiring.current_A) if is_limited else wiring.current_A
        per_ampere = float(frame.voltages[channel]) / float(frame.current_A[channel])
        return Electrical(per_ampere * flowing_A, flowing_A, is_limited)

    def frame(self) -> SimulatedFrame:
        """Readings of the multiplexer's current round, at its middle [V at the scene's current].

        The sheet is solved once per round, at its first reading, and again for the rest of a round that is resumed
        much later.
        """
        number, now_s = self.wiring.frame, self.clock.now()
        if self._taken is None or self._taken[0] != number or now_s > self._taken[1]:
            drives, measures = self.world.setting.sensor_type.pattern.shape
            half_s = drives * measures * self.wiring.reading_s / 2
            stale_s = now_s + _LATEST_ROUNDS * 2 * half_s
            self._taken = (number, stale_s, self.world.frame(now_s + half_s, number))
        return self._taken[2]


#: Driver → (module below this package, class, stream). Imported only where a station emulates one.
EMULATORS: Final[Mapping[str, tuple[str, str, type[Port]]]] = {
    "keithley-2600": ("source_meter", "EmulatedSourceMeter", TcpPort),
    "esp32-multiplexer": ("multiplexer", "EmulatedMultiplexer", PtyPort),
    "marlin-applicator": ("applicator", "EmulatedApplicator", PtyPort),
    "serial-load-cell": ("samplers", "EmulatedLoadCell", PtyPort),
    "serial-thermometer": ("samplers", "EmulatedThermometer", PtyPort),
    "ert-board-stream": ("ert_board", "EmulatedErtBoard", PtyPort),
}


class Emulation:
    """Running emulators of one station; close it, or use it as a context manager.

    ConfigError if there is no emulator for a driver.

    Parameters
    ----------
    specs : the station's instruments; those whose address is "emulated" are served.
    find : function that returns the emulator of a driver that is not among ours, see
        :func:`~cbsr_qa.plugin.hooks.cbsr_emulator`.
    """

    def __init__(
        self,
        specs: Iterable[InstrumentSpec],
        rig: EmulatedRig,
        find: Callable[[str], Emulator | None] = lambda driver: None,
    ) -> None:
        self.rig = rig
        self._find = find
        self.ports: dict[str, Port] = {}
        self.instruments: dict[str, Served] = {}
        try:
            for spec in specs:
                if spec.emulated:
                    self._start(spec)
        except BaseException:
            self.close()
            raise

    def fill_address(self, spec: InstrumentSpec) -> InstrumentSpec:
        """Return an instrument's table with its emulator's address; unchanged if it is not emulated.

        The new table no longer shows that it is emulated: use the original one for that.
        """
        if spec.role not in self.ports:
            return spec
        return replace(spec, options={**spec.options, "address": self.ports[spec.role].address})

    def arm(self, role: str, fault: Fault) -> None:
        """Inject a fault at the next command to an instrument."""
        self.ports[role].faults.arm(fault)

    def close(self) -> None:
        for port in self.ports.values():
            port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _start(self, spec: InstrumentSpec) -> None:
        make: Callable[[EmulatedRig, Mapping[str, Any], Callable[[bytes], None]], Served]
        stream: type[Port]
        if spec.driver in EMULATORS:
            module, name, stream = EMULATORS[spec.driver]
            make = getattr(import_module(f"cbsr_qa.simulate.instruments.{module}"), name)
        elif (emulator := self._find(spec.driver)) is not None:
            make, stream = emulator.make, TcpPort if emulator.network else PtyPort
        else:
            raise ConfigError(
                f"instrument {spec.role!r} has address {EMULATED!r}, but driver {spec.driver!r} has no emulator",
                remedy=f"emulated drivers: {', '.join(sorted(EMULATORS))}; a plugin adds one with cbsr_emulator",
            )
        port = self.ports[spec.role] = stream(f"emulated {spec.role}")
        instrument = self.instruments[spec.role] = make(self.rig, spec.options, port.send)
        if isinstance(instrument, FreeRunning):
            instrument.attach(port)
        port.serve(instrument)
