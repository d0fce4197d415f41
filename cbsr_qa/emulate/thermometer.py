"""An emulated thermometer: one line a second with the temperature of a room that slowly warms and cools."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

from cbsr_qa.emulate.faults import Fault
from cbsr_qa.emulate.free_running import LineSender
from cbsr_qa.emulate.rig import EmulatedRig
from cbsr_qa.emulate.streams import Port
from cbsr_qa.simulate.streams import RandomStream

_MEAN_C: Final = 22.0
_SWING_K: Final = 0.3
_PERIOD_S: Final = 1200.0
_NOISE_K: Final = 0.01
#: What it reads too much once it is told to [K].
OVERLOAD_K: Final = 100.0


class EmulatedThermometer:
    """Sends the temperature, by the same scale that the driver takes it back with.

    It has a room of its own: the world's effects do not say at which temperature they are.

    Parameters
    ----------
    rig : whose clock it runs by, and whose seed its noise has.
    options : of the driver's table: ``scale``, ``offset``, ``rate_hz``.
    send : takes the lines.
    """

    def __init__(self, rig: EmulatedRig, options: Mapping[str, Any], send: Callable[[bytes], None]) -> None:
        self._rig = rig
        self._scale, self._offset = options.get("scale", 1.0), options.get("offset", 0.0)
        self._noise = RandomStream(rig.world.setting.seed, "emulated-thermometer")
        self._more_K = 0.0
        self._began_s = rig.world.setting.began_s
        self._lines = LineSender(
            rig, send, options.get("rate_hz", 1.0), self._line, banner="thermometer ready", other=self._overload
        )

    def attached(self, line: Port) -> None:
        """Be given the line; its faults are met by the lines that are sent."""
        self._lines.attached(line)

    def received(self, data: bytes) -> bytes:
        """It does not listen."""
        return b""

    def misbehave(self, fault: Fault) -> None:
        """Read far too much from the next line on, or spoil that line."""
        self._lines.misbehave(fault)

    def _line(self, number: int, time_s: float) -> str:
        room_C = _MEAN_C + _SWING_K * math.sin(2 * math.pi * (self._began_s + time_s) / _PERIOD_S)
        # A resumed session draws noise of its own: a block of 2³² samples for each millisecond it may have begun at.
        index = (math.ceil(1e3 * self._began_s) << 32) + number
        read_C = room_C + _NOISE_K * float(self._noise.normal(index)) + self._more_K
        return f"{(read_C - self._offset) / self._scale:.2f}"

    def _overload(self, fault: Fault) -> None:
        if fault is Fault.OVERLOAD:
            self._more_K = OVERLOAD_K
