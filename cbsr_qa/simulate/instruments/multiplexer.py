"""An emulated 16-channel multiplexer on an ESP32, command firmware: one byte at a time, log lines in between."""

import threading
from collections.abc import Callable, Mapping
from typing import Any, Final

from cbsr_qa.simulate.instruments.rig import EmulatedRig
from cbsr_qa.simulate.instruments.streams import Fault

#: Duration of a step [s]: the byte, its echo, and the switches.
_STEP_S: Final = 2e-4
#: Steps between log lines, which come alternately before and after the echo.
_LOG_EVERY: Final = 50
#: The counter has no line end and waits for the next log line [s, real time]; in the firmware for up to a second.
_COUNTER_LATE_S: Final = 0.02
#: Readings further apart belong to different rounds.
_LONGEST_READING_S: Final = 1.0

_BOOT: Final = (
    b"ets Jun  8 2016 00:22:57\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\r\n"
    b"\x1b[0;32mI (28) boot: ESP-IDF v4.4 2nd stage bootloader\x1b[0m\r\n"
    b"\x1b[0;33mW (312) mux: 16 channels, adjacent pairs\x1b[0m\r\n"
)


class EmulatedMultiplexer:
    """Steps through all combinations of its pairs, with one of the two in the inner loop.

    Its firmware knows no sensor types: it counts, and its pairs are k and k + 1 + skip. ``options``: of the driver's
    table: ``inner``, ``current_skip``, ``voltage_skip``.
    """

    def __init__(self, rig: EmulatedRig, options: Mapping[str, Any], send: Callable[[bytes], None]) -> None:
        self._rig = rig
        self._send = send
        pattern = rig.world.setting.sensor_type.pattern
        self._count = pattern.electrode_count
        self._current_inner = options.get("inner", "current") == "current"
        self._skips = int(options.get("current_skip", 0)), int(options.get("voltage_skip", 0))
        self._drives = {frozenset(pair): index for index, pair in enumerate(pattern.drive)}
        self._measures = {frozenset(pair): index for index, pair in enumerate(pattern.measure)}
        self._counter = 0
        self._steps = 0
        self._stepped_s = rig.clock.now()
        self._waiting = b""
        self._writing = threading.Lock()
        self._boot()

    def receive(self, data: bytes) -> bytes:
        """Execute the first received byte; the others are lost, as in the firmware."""
        command = data[:1]
        with self._rig.lock:
            reply = self._execute(command)
        with self._writing:
            waiting, self._waiting = self._waiting, b""
        if command == b"c":
            self._later(str(self._counter).encode())
        return waiting + reply

    def misbehave(self, fault: Fault) -> None:
        """Restart: the counter is reset and pending output is lost."""
        if fault is Fault.RESET:
            with self._rig.lock:
                self._boot()

    def _execute(self, command: bytes) -> bytes:
        if command == b"i":
            self._step()
            log = self._log() if self._steps % _LOG_EVERY == 0 else b""
            return log + command if self._steps % (2 * _LOG_EVERY) else command + log
        if command == b"g":
            (source, sink), (negative, positive) = self._pairs()
            # The firmware's labels of source and sink are swapped.
            return command + f"isrc{sink},isnk{source},vn{negative},vp{positive}\r\n".encode()
        return command

    def _pairs(self) -> tuple[tuple[int, int], tuple[int, int]]:
        inner, outer = self._counter % self._count, self._counter // self._count
        drive, measure = (inner, outer) if self._current_inner else (outer, inner)
        ends = [(k, (k + 1 + skip) % self._count) for k, skip in zip((drive, measure), self._skips, strict=True)]
        return ends[0], ends[1]

    def _step(self) -> None:
        now_s = self._rig.clock.now()
        if now_s - self._stepped_s < _LONGEST_READING_S:
            self._rig.wiring.reading_s = now_s - self._stepped_s
        self._stepped_s = now_s
        self._rig.clock.sleep(_STEP_S)
        self._steps += 1
        self._connect((self._counter + 1) % self._count**2)

    def _connect(self, counter: int) -> None:
        self._counter = counter
        drive, measure = self._pairs()
        wiring = self._rig.wiring
        wiring.frame += counter == 0
        # Pairs missing in the sensor type are not simulated; the driver refuses such a firmware.
        wiring.drive = self._drives.get(frozenset(drive), 0)
        wiring.measure = self._measures.get(frozenset(measure), 0)

    def _boot(self) -> None:
        self._waiting = b""
        self._connect(0)
        self._send(_BOOT)

    def _log(self) -> bytes:
        return f"\x1b[0;32mI ({1000 + self._steps}) mux: {self._steps} steps so far, i\x1b[0m\r\n".encode()

    def _later(self, digits: bytes) -> None:
        """Send the counter with the next log line or the next answer, whichever comes first."""
        with self._writing:
            self._waiting += digits
        timer = threading.Timer(_COUNTER_LATE_S, self._send_log)
        timer.daemon = True
        timer.start()

    def _send_log(self) -> None:
        with self._writing:
            waiting, self._waiting = self._waiting, b""
        if waiting:
            self._send(waiting + self._log())
