"""An emulated load cell with its amplifier: text lines, eight a second."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

from cbsr_qa.emulate.faults import Fault
from cbsr_qa.emulate.free_running import LineSender
from cbsr_qa.emulate.rig import EmulatedRig
from cbsr_qa.emulate.streams import Port

#: Newtons of one gram force.
_NEWTON_PER_G: Final = 9.80665e-3
#: Its clock runs fast by this much, as a ceramic resonator's does.
_DRIFT: Final = 4e-5
#: What it reads too much once it is told to [N].
OVERLOAD_N: Final = 200.0


class EmulatedLoadCell:
    """Sends what the world's force is to it, by the same scale that the driver takes it back with.

    Parameters
    ----------
    rig : whose world it weighs.
    options : of the driver's table: ``unit``, ``scale``, ``offset``, ``sign``, ``time``, ``rate_hz``, ``limit_N``.
    send : takes the lines.
    """

    def __init__(self, rig: EmulatedRig, options: Mapping[str, Any], send: Callable[[bytes], None]) -> None:
        self._rig = rig
        self._per_unit_N = 1.0 if options.get("unit", "N") in ("N", "counts") else _NEWTON_PER_G
        self._scale, self._offset = options.get("scale", 1.0), options.get("offset", 0.0)
        self._sign, self._limit_N = options.get("sign", 1), options.get("limit_N")
        self._counts = options.get("unit") == "counts"
        self._with_time = options.get("time", "device_ms") == "device_ms"
        self._more_N = 0.0
        # A resumed session draws noise of its own: a block of 2³² samples for each millisecond it may have begun at.
        self._first = math.ceil(1e3 * rig.world.setting.began_s) << 32
        self._lines = LineSender(
            rig, send, options.get("rate_hz", 8.0), self._line, banner="load cell ready", other=self._overload
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
        force_N = self._rig.world.force_N(time_s, self._first + number) + self._more_N
        if self._limit_N is not None:
            force_N = min(max(force_N, -self._limit_N), self._limit_N)
        value = (self._sign * force_N / self._per_unit_N - self._offset) / self._scale
        said = f"{round(value)}" if self._counts else f"{value:.6g}"
        if not self._with_time:
            return said
        return f"{round(1e3 * (1 + _DRIFT) * (time_s - self._lines.started_s))},{said}"

    def _overload(self, fault: Fault) -> None:
        if fault is Fault.OVERLOAD:
            self._more_N = OVERLOAD_N
