"""Instruments that send a line every so often, whether anybody asks or not."""

from collections.abc import Callable
from typing import Final

from cbsr_qa.clock import RealClock
from cbsr_qa.emulate.faults import Fault
from cbsr_qa.emulate.rig import EmulatedRig
from cbsr_qa.emulate.streams import Port

#: How long lines that come late are held back, and how long a restart takes [s].
LATE_S: Final = 3.0
_BOOT_S: Final = 1.0
#: The kernel hands bytes to the far end of a pseudo terminal a moment after they were written [s, real time].
_HANDED_OVER_S: Final = 0.01
#: From so many unread bytes on nobody reads.
_FULL: Final = 3000


class LineSender:
    """Sends what fell due whenever time has passed on the clock, and can be told to do so badly.

    Faults of the link are met here too, since nobody sends commands that could meet them.

    Parameters
    ----------
    rig : whose clock it runs by.
    send : takes the bytes.
    rate_hz : of the lines.
    line : from a line's number and its time [s] to its text, without line end.
    banner : what it says when it starts.
    other : told those faults that are not the line's.
    """

    def __init__(
        self,
        rig: EmulatedRig,
        send: Callable[[bytes], None],
        rate_hz: float,
        line: Callable[[int, float], str],
        *,
        banner: str = "",
        other: Callable[[Fault], None] = lambda fault: None,
    ) -> None:
        self._other = other
        self._rig, self._send, self._rate_hz, self._line, self._banner = rig, send, rate_hz, line, banner
        self._port: Port | None = None
        self._told: list[Fault] = []
        self._late = b""
        self._late_until_s: float | None = None
        self._silent = False
        self._last = b""
        with rig.lock:
            self._sent = int(rig.clock.now() * rate_hz)
            #: When it was switched on or restarted [s].
            self.started_s = rig.clock.now()
            rig.clock.watch(self._follow)

    def attached(self, line: Port) -> None:
        """Be given the line; its faults are met by the lines that are sent."""
        self._port = line

    def received(self, data: bytes) -> bytes:
        """It does not listen."""
        return b""

    def misbehave(self, fault: Fault) -> None:
        """Meet a fault with the next line."""
        with self._rig.lock:
            self._told.append(fault)

    def _follow(self, now_s: float) -> None:
        due = b""
        while (self._sent + 1) / self._rate_hz <= now_s:
            self._sent += 1
            due_s = self._sent / self._rate_hz
            if due_s < self.started_s:
                continue  # it boots
            said = f"{self._line(self._sent, due_s)}\r\n".encode("ascii")
            while (fault := self._fault()) is not None:
                said = self._spoilt(fault, said, due_s)
            due += self._in_time(said, due_s)
        if due and not self._silent:
            self._hand_over(due)

    def _fault(self) -> Fault | None:
        if self._told:
            return self._told.pop(0)
        return None if self._port is None else self._port.faults.met()

    def _spoilt(self, fault: Fault, said: bytes, due_s: float) -> bytes:
        match fault:
            case Fault.DROP:
                self._silent = True
                if self._port is not None:
                    self._port.hang_up()
            case Fault.SILENCE:
                self._silent = True
            case Fault.GARBLE:
                return bytes([said[0] ^ 0x15]) + said[1:]
            case Fault.STALE:
                return self._last + said
            case Fault.DELAY:
                self._late_until_s = due_s + LATE_S
            case Fault.RESET:
                self.started_s = due_s + _BOOT_S
                return f"{self._banner}\r\n".encode("ascii")
            case _:
                self._other(fault)
        return said

    def _in_time(self, said: bytes, due_s: float) -> bytes:
        """Return what is sent now: a line, nothing, or all that was held back before it."""
        self._last = said
        self._late += said
        if self._late_until_s is not None and due_s < self._late_until_s:
            return b""
        self._late_until_s, all_of_it, self._late = None, self._late, b""
        return all_of_it

    def _hand_over(self, said: bytes) -> None:
        """Send, and wait until it is where the driver finds it: time goes on only then."""
        before = _FULL if self._port is None else self._port.unread()
        self._send(said)
        clock = RealClock()
        while before < _FULL and self._port is not None and self._port.unread() == before:
            if clock.now() > _HANDED_OVER_S:
                return
