"""Emulated samplers that stream text lines unasked: a load cell (eight a second) and a thermometer (one a second)."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Final

from cbsr_qa.simulate.instruments.rig import EmulatedRig
from cbsr_qa.simulate.instruments.streams import Fault, Port
from cbsr_qa.simulate.streams import RandomStream
from cbsr_qa.system.clock import RealClock

#: Delay of late lines, and duration of a restart [s].
LATE_S: Final = 3.0
_BOOT_S: Final = 1.0
#: The kernel delivers bytes to the far end of a pseudo terminal a moment after they were written [s, real time].
_HANDED_OVER_S: Final = 0.01
#: Number of unread bytes at which the other end is taken not to read.
_FULL: Final = 3000
#: From the beginning of a step, or of an order to the head, to the next line [s]: a power of two, less than any order
#: takes, so that a slow instrument is heard too.
_NEXT_LINE_S: Final = 1 / 16


class LineSender(ABC):
    """Sends due lines as time passes on the clock, optionally with faults.

    Faults of the link are handled here too, since there are no commands to trigger them.
    """

    #: Excess reading after an overload fault, in its own unit.
    overload: float

    def __init__(self, rig: EmulatedRig, send: Callable[[bytes], None], rate_hz: float, banner: str) -> None:
        self._rig, self._send, self._rate_hz, self._banner = rig, send, rate_hz, banner
        self._more = 0.0
        # Before the first step a resumed session draws different noise: a block of 2³² samples for each millisecond
        # at which it may have begun.
        self._first = math.ceil(1e3 * rig.world.setting.began_s) << 32
        self._port: Port | None = None
        self._told: list[Fault] = []
        self._late = b""
        self._late_until_s: float | None = None
        self._silent = False
        self._last = b""
        with rig.lock:
            self._sent = int(rig.clock.now() * rate_hz)
            self._before_s = 0.0
            #: Time of switching on or of the last restart [s].
            self.started_s = rig.clock.now()
            rig.clock.watch(self._follow)
            rig.count_with(self._count_from)

    def attach(self, line: Port) -> None:
        """Attach the line; faults hit the lines sent."""
        self._port = line

    def receive(self, data: bytes) -> bytes:
        return b""

    def misbehave(self, fault: Fault) -> None:
        """Inject a fault into the next line; an overload persists."""
        with self._rig.lock:
            self._told.append(fault)

    @abstractmethod
    def _line(self, number: int, time_s: float) -> str:
        """Text of a line by its number and its time, without line end."""

    def _count_from(self, first: int) -> None:
        """Count lines from now on: they come at the same times after a step begins, whatever was before it."""
        self._first, self._sent = first, 0
        period_s = 1 / self._rate_hz
        self._before_s = self._rig.clock.now() + min(_NEXT_LINE_S, period_s) - period_s

    def _follow(self, now_s: float) -> None:
        due = b""
        while (due_s := self._before_s + (self._sent + 1) / self._rate_hz) <= now_s:
            self._sent += 1
            if due_s < self.started_s:
                continue  # it boots
            line = f"{self._line(self._sent, due_s)}\r\n".encode("ascii")
            while (fault := self._take_fault()) is not None:
                line = self._spoil_line(fault, line, due_s)
            due += self._delay_line(line, due_s)
        if due and not self._silent:
            self._hand_over(due)

    def _take_fault(self) -> Fault | None:
        if self._told:
            return self._told.pop(0)
        return None if self._port is None else self._port.faults.take()

    def _spoil_line(self, fault: Fault, line: bytes, due_s: float) -> bytes:
        match fault:
            case Fault.DROP:
                self._silent = True
                if self._port is not None:
                    self._port.hang_up()
            case Fault.SILENCE:
                self._silent = True
            case Fault.GARBLE:
                return bytes([line[0] ^ 0x15]) + line[1:]
            case Fault.STALE:
                return self._last + line
            case Fault.DELAY:
                self._late_until_s = due_s + LATE_S
            case Fault.RESET:
                self.started_s = due_s + _BOOT_S
                return f"{self._banner}\r\n".encode("ascii")
            case Fault.OVERLOAD:
                self._more = self.overload
        return line

    def _delay_line(self, line: bytes, due_s: float) -> bytes:
        self._last = line
        self._late += line
        if self._late_until_s is not None and due_s < self._late_until_s:
            return b""
        self._late_until_s, all_of_it, self._late = None, self._late, b""
        return all_of_it

    def _hand_over(self, due: bytes) -> None:
        """Send, and wait until the driver can read it before time advances; a link that is down takes nothing."""
        port = self._port
        if port is None:
            return self._send(due)
        if port.down:
            return
        unread_before = port.unread()
        self._send(due)
        clock = RealClock()
        while unread_before < _FULL and not port.down and port.unread() == unread_before:
            if clock.now() > _HANDED_OVER_S:
                return


#: Newtons of one gram force.
_NEWTON_PER_G: Final = 9.80665e-3
#: Its clock runs fast by this much, as a ceramic resonator's does.
_DRIFT: Final = 4e-5
#: Excess reading after an overload fault [N].
OVERLOAD_N: Final = 200.0


class EmulatedLoadCell(LineSender):
    """Sends the world's force, in the scale that the driver converts back.

    ``options``: of the driver's table: ``unit``, ``scale``, ``offset``, ``sign``, ``time``, ``rate_hz``, ``limit_N``.
    """

    overload = OVERLOAD_N

    def __init__(self, rig: EmulatedRig, options: Mapping[str, Any], send: Callable[[bytes], None]) -> None:
        super().__init__(rig, send, options.get("rate_hz", 8.0), "load cell ready")
        self._per_unit_N = 1.0 if options.get("unit", "N") in ("N", "counts") else _NEWTON_PER_G
        self._scale, self._offset = options.get("scale", 1.0), options.get("offset", 0.0)
        self._sign, self._limit_N = options.get("sign", 1), options.get("limit_N")
        self._counts = options.get("unit") == "counts"
        self._with_time = options.get("time", "device_ms") == "device_ms"

    def _line(self, number: int, time_s: float) -> str:
        force_N = self._rig.world.force_N(time_s, self._first + number) + self._more
        if self._limit_N is not None:
            force_N = min(max(force_N, -self._limit_N), self._limit_N)
        value = (self._sign * force_N / self._per_unit_N - self._offset) / self._scale
        reading = f"{round(value)}" if self._counts else f"{value:.6g}"
        if not self._with_time:
            return reading
        return f"{round(1e3 * (1 + _DRIFT) * (time_s - self.started_s))},{reading}"


_MEAN_C: Final = 22.0
_SWING_K: Final = 0.3
_PERIOD_S: Final = 1200.0
_NOISE_K: Final = 0.01
#: Excess reading after an overload fault [K].
OVERLOAD_K: Final = 100.0


class EmulatedThermometer(LineSender):
    """Sends the temperature, in the scale that the driver converts back.

    Its temperature is independent: the world's effects do not state theirs.

    Parameters
    ----------
    rig : gives the clock, and the seed of its noise.
    options : options of the driver's table: ``scale``, ``offset``, ``rate_hz``.
    """

    overload = OVERLOAD_K

    def __init__(self, rig: EmulatedRig, options: Mapping[str, Any], send: Callable[[bytes], None]) -> None:
        super().__init__(rig, send, options.get("rate_hz", 1.0), "thermometer ready")
        self._scale, self._offset = options.get("scale", 1.0), options.get("offset", 0.0)
        self._noise = RandomStream(rig.world.setting.seed, "emulated-thermometer")
        self._began_s = rig.world.setting.began_s

    def _line(self, number: int, time_s: float) -> str:
        room_C = _MEAN_C + _SWING_K * math.sin(2 * math.pi * (self._began_s + time_s) / _PERIOD_S)
        read_C = room_C + _NOISE_K * float(self._noise.normal(self._first + number)) + self._more
        return f"{(read_C - self._offset) / self._scale:.2f}"
