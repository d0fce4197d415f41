"""Marlin's serial protocol from the host's side: every command is executed exactly once, or reported as failed.

Lines carry a number and a checksum, so that one that was garbled is asked for again, and one whose answer was lost
can be sent again without being done twice: a printer that has it already says which number it expects next.
"""

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import reduce
from operator import xor
from typing import Final

from cbsr_qa.plugin import InstrumentError, SerialLink
from cbsr_qa.plugin.links.serial_link import describe_partial_line
from cbsr_qa.system.clock import RealClock

#: Lines are counted from here on after a start: a printer that asks for number 1 has restarted.
_FIRST_NUMBER: Final = 1000
#: Size of the printer's buffer of one line [bytes].
_MAX_LINE_LENGTH: Final = 96
#: Number of times a line is sent, or a query repeated, before it counts as failed.
_ATTEMPTS: Final = 4
#: How long a printer may go on saying that it is busy [s, real time]: homing with mesh levelling takes minutes.
_BUSY_AT_MOST_S: Final = 600.0
#: Interval of queries while a printer boots [s, real time].
_BOOT_QUERY_S: Final = 0.5
#: Number of times a text is sent that should come back, before the printer counts as silent.
_TOKEN_ATTEMPTS: Final = 3
#: A busy printer says so every two seconds, the first time two seconds after the command came; half a second more is
#: allowed [s, real time].
_BUSY_EVERY_S: Final = 2.5
#: Commands that are only acknowledged when what they do, or wait for, is over.
_SLOW_COMMANDS: Final = ("G28", "M400")
#: An acknowledgement, what firmware with ADVANCED_OK says of its buffers, and what else stands on its line.
_ACKNOWLEDGED: Final = re.compile(r"ok(?:\s+[NPB]\d+\b)*\s*(.*)")
_CHECK: Final = "check its address, its cable and its power"
_HOME: Final = "it must home before it moves again"


class MarlinLink:
    """Sends commands to a printer and waits for their acknowledgements.

    Parameters
    ----------
    boot_s : how long the printer may take from the opening of its port to its first answer [s, real time].

    Raises
    ------
    InstrumentError
        If it does not answer within this time.
    """

    def __init__(self, link: SerialLink, *, boot_s: float) -> None:
        self._link = link
        self._boot_s = boot_s
        self._time = RealClock()
        self._number = _FIRST_NUMBER
        self._tokens = 0
        self._exchanging = threading.RLock()
        self._lost = False
        #: Whether it has stopped answering; it may still receive commands.
        self.silent = False
        #: How often the printer has restarted or halted since the port was first opened: its position is lost then.
        self.restarts = 0
        self._begin()

    @property
    def down(self) -> bool:
        """Whether the line was found to be down; only reopening mends that."""
        return self._link.down

    def command(self, text: str) -> list[str]:
        """Execute a command, and return the printer's output up to its acknowledgement, and on its line.

        After a restart lines are counted anew: whether the command may be done is the caller's to know.
        InstrumentError if it is not acknowledged, the printer does not know it, or has restarted.
        """
        with self._exchanging:
            self._discard_old_lines()
            if self._lost:
                self._begin()
            self._number += 1
            lines = self._exchange(self._number, text)
        if any("unknown command" in line.lower() for line in lines):
            raise self._link.error(f"it does not know the command {text!r}", remedy="check its firmware")
        return lines

    def query(self, text: str) -> list[str]:
        """Repeat a query without side effects until there is exactly one answer."""
        with self._exchanging:
            for _ in range(_ATTEMPTS):
                lines = self.command(text)
                if lines and not self._discard_old_lines():
                    return lines
        raise self._link.error(
            f"it does not answer {text!r} in a way that is understood", remedy=_CHECK, retryable=True
        )

    @contextmanager
    def alone(self, patience_s: float) -> Iterator[bool]:
        """Keep other threads from the line; yield False if one of them did not release it within this time."""
        is_acquired = self._exchanging.acquire(timeout=patience_s)
        try:
            yield is_acquired
        finally:
            if is_acquired:
                self._exchanging.release()

    def shout(self, *commands: str) -> None:
        """Send commands without number or waiting, for when another thread blocks the line or no answers arrive."""
        self._link.write(b"\n" + b"".join(f"{text}\n".encode("ascii") for text in commands))

    def reopen(self) -> None:
        """Open the port again; printers restart on that, so the position is lost.

        InstrumentError if it does not open, or there is no answer.
        """
        with self._exchanging:
            self._note_lost_position()
            self._link.reopen()
            self._begin()

    # --- start ---

    def _begin(self) -> None:
        """Wait until the printer has booted, and restart line numbers."""
        self._number = _FIRST_NUMBER
        until_s = self._time.now() + self._boot_s
        while not self._answers_token(_BOOT_QUERY_S):
            if self._time.now() > until_s:
                partial_line = self._link.partial_line
                said = f", and what came is {describe_partial_line(partial_line)}" if partial_line else ""
                raise self._link.error(
                    f"no Marlin printer answers within {self._boot_s:g} s{said}",
                    remedy="check its address, its baud rate, its cable and its power",
                )
        self._exchange(self._number, f"M110 N{self._number}")
        self._lost = False

    def _answers_token(self, patience_s: float) -> bool:
        """Send a text and read until it comes back; return whether it did.

        It comes back whether the firmware knows M118 or not. All lines before it are old.
        """
        self._tokens += 1
        token = f"sync-{self._tokens}."
        self._link.write(f"\nM118 {token}\n".encode("ascii"))
        try:
            while token not in self._read_line(patience_s):
                pass
            while not self._read_line(patience_s).startswith("ok"):
                pass
        except InstrumentError as error:
            if not error.retryable:
                raise
            return False
        return True

    # --- exchange ---

    def _exchange(self, number: int, text: str) -> list[str]:
        """Send a numbered line until it was executed."""
        body = f"N{number} {text}"
        line = f"{body}*{reduce(xor, body.encode('ascii'), 0)}\n".encode("ascii")
        assert len(line) <= _MAX_LINE_LENGTH, f"{text!r} is too long for the printer's buffer"
        for _ in range(_ATTEMPTS):
            self._link.write(line)
            try:
                lines, requested = self._read_answer(may_take_long=text.startswith(_SLOW_COMMANDS))
            except InstrumentError as error:
                if not error.retryable:
                    raise
                # What comes from here on belongs to what is sent from here on.
                if not any(self._answers_token(self._link.timeout_s) for _ in range(_TOKEN_ATTEMPTS)):
                    self.silent = True
                    raise self._link.error("it does not answer any more", remedy=_CHECK) from error
                continue
            self.silent = False
            if requested in (None, number + 1):  # the latter: it was done before, and its answer was lost
                return lines
            if requested != number:
                self._note_lost_position()
                raise self._link.error(
                    f"it asks for line {requested} instead of {number}: it has restarted", remedy=_HOME
                )
        raise self._link.error(f"{text!r} did not get through in {_ATTEMPTS} attempts", remedy=_CHECK)

    def _read_answer(self, *, may_take_long: bool) -> tuple[list[str], int | None]:
        """Read up to the acknowledgement; return the output, and the line that the printer requests again, if any.

        Some firmware writes the answer on the acknowledgement's own line: ``ok X:0.00 Y:0.00 …``.

        ``may_take_long``: the command may take long, and the printer says only after a while that it is busy with it.
        """
        lines: list[str] = []
        requested: int | None = None
        began_s = self._time.now()
        busy_s = max(self._link.timeout_s, _BUSY_EVERY_S)
        until_s = began_s + (busy_s if may_take_long else self._link.timeout_s)
        while True:
            line = self._read_line(max(until_s - self._time.now(), 0.0))
            if acknowledged := _ACKNOWLEDGED.match(line):
                return lines + [answer for answer in acknowledged.groups() if answer], requested
            if line.startswith("echo:busy") and self._time.now() < began_s + _BUSY_AT_MOST_S:
                until_s = self._time.now() + busy_s
            elif line.startswith("Resend:"):
                digits = line.partition(":")[2].strip()
                requested = int(digits) if digits.isdigit() else requested
            elif not line.startswith("Error:"):
                lines.append(line)

    def _read_line(self, timeout_s: float) -> str:
        line = self._link.read_line(timeout_s).decode("ascii", "replace").strip()
        self._check_for_restart(line)
        return line

    def _check_for_restart(self, line: str) -> None:
        """Note the lost position if a line reports a restart or halt; InstrumentError once commands were sent."""
        if line == "start" or "Printer halted" in line or "kill()" in line:
            self._note_lost_position()
            if self._number > _FIRST_NUMBER:
                raise self._link.error(f"it has restarted (it said {line!r}): its position is lost", remedy=_HOME)

    def _note_lost_position(self) -> None:
        self.restarts += 1
        self._lost = True

    def _discard_old_lines(self) -> bool:
        """Discard lines since the last answer, but check them for a restart; return whether there were any."""
        lines = self._link.read_available().decode("ascii", "replace").splitlines()
        for line in lines:
            self._check_for_restart(line.strip())
        return bool(lines)
