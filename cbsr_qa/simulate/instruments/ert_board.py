"""An emulated ERT board: it scans and sends continuously from power-on, and takes no commands."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from cbsr_qa.domain.numbers import Indices
from cbsr_qa.simulate.instruments.rig import EmulatedRig
from cbsr_qa.simulate.instruments.streams import Fault, Port

Counts = Indices

#: Readings away from the driven electrodes use this much of the converter, to leave room for loads.
_FILLED: Final = 0.4
_UNSIGNED: Final = (0, 2**16 - 1)
_SIGNED: Final = (-(2**15), 2**15 - 1)
#: Number of unread bytes above which the next row is lost: nothing reads them.
_ROOM: Final = 2048
#: Number of frames whose rows are kept after a longer jump in time; older rows are lost.
_KEPT_FRAMES: Final = 2
#: Start-up time before the first frame, and what it prints then.
_BOOT_S: Final = 0.3
_BOOT: Final = b"ets Jul 29 2019 12:21:46\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\r\n"
#: Rounding of due times; far below a row's time [s].
_NOW_S: Final = 1e-9


class EmulatedErtBoard:
    """Sends a row of counts whenever one is due on the clock.

    Counts are ``zero_counts`` plus the reading times a scale that uses the range well, clipped to the range. Every
    frame is computed for its middle, which is still in the future when its first row is sent: only movements that
    begin within the frame are missing, and drivers discard such frames. ``options``: ``format``, ``frame_period_s``,
    ``signed``, ``zero_counts``, ``order`` and ``first_reading`` as for the driver.
    """

    def __init__(self, rig: EmulatedRig, options: Mapping[str, Any], send: Callable[[bytes], None]) -> None:
        self._rig = rig
        self._send = send
        self._text = options.get("format", "binary") == "ascii"
        self._range = _SIGNED if options.get("signed", False) else _UNSIGNED
        self._zero = float(options.get("zero_counts", 0))
        self._by_drive = options.get("order", "measure") == "drive"
        self._first = int(options.get("first_reading", 0))
        self._pairs = len(rig.world.setting.sensor_type.pattern.drive)
        self._row_s = float(options.get("frame_period_s", rig.world.setting.frame_period_s)) / self._pairs
        self._line: Port | None = None
        self._origin_s = rig.clock.now()
        self._next_row = 0
        self._frame: tuple[int, Counts] | None = None
        # Addresses of random numbers: different after a restart, and in a session that resumes a run.
        self._session = math.ceil(1e3 * rig.world.setting.began_s)
        self._silent = False
        self._last = b""
        world = self._rig.world
        unloaded = np.abs(world.sheet.unloaded) * world.setting.current_A
        largest_V = float(unloaded[world.setting.sensor_type.pattern.usable()].max())
        self._scale = _FILLED * self._range[1] / largest_V

    def attach(self, line: Port) -> None:
        self._line = line
        self._rig.clock.watch(self._time_passed)

    def receive(self, data: bytes) -> bytes:
        """Ignore received bytes: the board takes no commands."""
        del data
        return b""

    def misbehave(self, fault: Fault) -> None:
        """Start again (RESET); no other fault applies to an instrument without commands."""
        if fault is Fault.RESET:
            self._send(_BOOT)
            self._origin_s = self._rig.clock.now() + _BOOT_S
            self._next_row = 0
            self._session += 1
            self._frame = None

    def _time_passed(self, now_s: float) -> None:
        self._next_row = max(self._next_row, self._due(now_s) - _KEPT_FRAMES * self._pairs)
        while self._next_row < self._due(now_s) and self._line is not None and not self._silent:
            row, self._next_row = self._next_row, self._next_row + 1
            if self._line.unread() < _ROOM:
                self._send_row(self._line, row)

    def _due(self, now_s: float) -> int:
        return int((now_s - self._origin_s + _NOW_S) / self._row_s)

    def _send_row(self, line: Port, row: int) -> None:
        fault = line.faults.take()
        if fault is Fault.DROP:
            self._silent = True
            return line.hang_up()
        self._silent = fault is Fault.SILENCE
        if fault is Fault.RESET:
            return self.misbehave(fault)
        row_bytes = self._encode_row(row)
        if fault is Fault.GARBLE:
            row_bytes = row_bytes[:7] + row_bytes[8:]
        if fault is Fault.STALE:
            row_bytes = self._last + row_bytes
        self._last = row_bytes
        if not self._silent:
            self._send(row_bytes)
        return None

    def _encode_row(self, row: int) -> bytes:
        """Bytes sent for a row; the text marker follows as soon as the previous frame ends."""
        frame, pair = divmod(row, self._pairs)
        counts = self._counts(frame).ravel()[self._pairs * pair : self._pairs * (pair + 1)].tolist()
        if self._text:
            return "".join(f"{count}," for count in counts).encode() + (
                b"\nA\n" if pair == self._pairs - 1 else b"\n"
            )
        sent = b"".join((count & 0xFFFF).to_bytes(2, "little") + b"\r" for count in counts)
        return sent + (b"A\r" if pair == self._pairs - 1 else b"")

    def _counts(self, frame: int) -> Counts:
        """Counts of a frame in the order they are sent, (pairs, pairs)."""
        if self._frame is None or self._frame[0] != frame:
            middle_s = self._origin_s + (frame + 0.5) * self._pairs * self._row_s
            volts = self._rig.world.frame(middle_s, (self._session << 32) + frame).voltages
            scanned = np.roll((volts.T if self._by_drive else volts).ravel(), -self._first)
            counts = np.rint(np.clip(self._zero + self._scale * scanned, *self._range)).astype(np.int64)
            self._frame = (frame, counts.reshape(self._pairs, self._pairs))
        return self._frame[1]
