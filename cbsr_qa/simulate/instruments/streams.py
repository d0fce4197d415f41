"""Byte streams to emulated instruments, a pseudo terminal or a loopback socket; their clock, and their faults."""

import errno
import fcntl
import os
import pty
import select
import socket
import struct
import termios
import threading
import tty
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from enum import StrEnum
from typing import Final, Protocol, runtime_checkable

from cbsr_qa.system.clock import VirtualClock

_READ_BYTES: Final = 4096
#: Interval at which a thread checks whether to end [s, real time].
_LOOK_S: Final = 0.2
#: Delay of a delayed reply: longer than any driver waits [s, real time].
LATE_S: Final = 3.0


class WatchedClock(VirtualClock):
    """A virtual clock for several threads, which notifies its watchers as time passes.

    The runner sleeps in its own thread, emulated instruments in theirs; a free-running instrument (a load cell that
    sends eight samples a second) watches, and sends due lines before the sleep returns. ``start`` and ``speed`` are
    those of the virtual clock.
    """

    def __init__(self, start: datetime | None = None, *, speed: float | None = None) -> None:
        super().__init__(start, speed=speed)
        #: Held while time passes, and by an emulated instrument while it executes a command.
        self.lock = threading.RLock()
        self._watchers: list[Callable[[float], None]] = []

    def watch(self, watcher: Callable[[float], None]) -> None:
        """Add a watcher, called with the time after each advance; it must not sleep or block."""
        self._watchers.append(watcher)

    def now(self) -> float:
        """Total time slept by all threads [s]."""
        with self.lock:
            return super().now()

    def sleep(self, duration_s: float) -> None:
        """Advance by this much [s], and notify the watchers."""
        with self.lock:
            slept_s = self._advance(duration_s)
            now_s = super().now()
            for watcher in self._watchers:
                watcher(now_s)
        self._keep_pace(slept_s)


class Fault(StrEnum):
    """One fault, triggered by the next command after it was armed."""

    DROP = "drop"  #: the link hangs up and stays down
    SILENCE = "silence"  #: commands are accepted, but never answered again
    GARBLE = "garble"  #: one byte of the reply is wrong
    DELAY = "delay"  #: the reply comes after the driver's timeout
    STALE = "stale"  #: the previous reply is repeated before the right one
    RESET = "reset"  #: the instrument restarts and has lost its state
    COMPLIANCE = "compliance"  #: the source is at its voltage limit from now on
    RESEND = "resend"  #: a resend of the line is requested
    BUSY = "busy"  #: it reports busy for a while before it answers
    OVERLOAD = "overload"  #: the force reads far above any ceiling from now on


#: Faults of the link itself; the others are the instrument's, see ``Served.misbehave``.
OF_THE_LINK: Final = frozenset({Fault.DROP, Fault.SILENCE, Fault.GARBLE, Fault.DELAY, Fault.STALE})


class ArmedFaults:
    """Armed faults; armed in one thread, triggered in another."""

    def __init__(self) -> None:
        self._waiting: deque[Fault] = deque()

    def arm(self, fault: Fault) -> None:
        """Arm a fault for the next command; several faults hit one command each."""
        self._waiting.append(fault)

    @property
    def waiting(self) -> int:
        """Number of faults armed and not yet triggered."""
        return len(self._waiting)

    def take(self) -> Fault | None:
        """Take the fault that hits the current command."""
        with suppress(IndexError):
            return self._waiting.popleft()
        return None


class Served(Protocol):
    """An emulated instrument: bytes in, bytes out. Called only from its port's thread."""

    def receive(self, data: bytes) -> bytes:
        """Execute received bytes, possibly part of a command or several commands, and return the answers."""

    def misbehave(self, fault: Fault) -> None:
        """Inject a fault other than one of the link; unknown faults are ignored."""


@runtime_checkable
class FreeRunning(Served, Protocol):
    """An emulated instrument that sends unsolicited bytes, and so checks for armed faults itself."""

    def attach(self, line: "Port") -> None:
        """Attach the line, before serving starts."""


class Port(ABC):
    """Serves one emulated instrument in its own thread until it is closed."""

    address: str

    def __init__(self, name: str) -> None:
        self.faults = ArmedFaults()
        self._name = name
        self._over = threading.Event()
        self._silent = False
        self._last = b""
        self._thread: threading.Thread | None = None
        #: Exception of the instrument, to diagnose its silence.
        self.failure: BaseException | None = None

    def serve(self, instrument: Served) -> None:
        self._thread = threading.Thread(target=self._run, args=(instrument,), name=self._name, daemon=True)
        self._thread.start()

    def send(self, data: bytes) -> None:
        """Send unsolicited bytes, unless silenced; bytes that do not fit are lost, as on a real line."""
        if not self._silent:
            self._send(data)

    @abstractmethod
    def _send(self, data: bytes) -> None:
        """Send bytes that fit."""

    @property
    @abstractmethod
    def down(self) -> bool:
        """Whether the link is broken or closed, so that no byte passes."""

    def unread(self) -> int:
        """Number of bytes sent that no driver has read yet; 0 if unknown."""
        return 0

    @abstractmethod
    def hang_up(self) -> None:
        """Break the link, as by a pulled cable."""

    def close(self) -> None:
        """End the thread and release all resources."""
        self._over.set()
        self.hang_up()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=5 * _LOOK_S)

    def _run(self, instrument: Served) -> None:
        try:
            self._serve(instrument)
        except BaseException as error:  # noqa: BLE001 - an instrument that fails is a link that hangs up
            self.failure = error
            with suppress(OSError):
                self.hang_up()

    @abstractmethod
    def _serve(self, instrument: Served) -> None:
        """Receive and answer, until closed."""

    def _answer(self, instrument: Served, data: bytes) -> bytes | None:
        """Return the answer to received bytes, after any fault; None to hang up."""
        fault = self.faults.take()
        if fault is not None and fault not in OF_THE_LINK:
            instrument.misbehave(fault)
        if fault is Fault.DROP:
            return None
        self._silent = self._silent or fault is Fault.SILENCE
        reply = instrument.receive(data)
        if self._silent:
            return b""
        if fault is Fault.GARBLE and reply:
            reply = bytes([reply[0] ^ 0x15]) + reply[1:]
        if fault is Fault.DELAY:
            self._over.wait(LATE_S)
        answer, self._last = (self._last if fault is Fault.STALE else b"") + reply, reply or self._last
        return answer


class PtyPort(Port):
    """A pseudo terminal in raw mode; the driver opens :attr:`address` like a serial port."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._master, self._slave = pty.openpty()
        # The slave stays open here, so that the line survives while no driver has it open.
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self._master, False)
        self.address = os.ttyname(self._slave)
        self._writing = threading.Lock()
        self._wakes, self._wake = os.pipe()

    def _send(self, data: bytes) -> None:
        with self._writing, suppress(BlockingIOError, OSError):
            os.write(self._master, data)

    @property
    def down(self) -> bool:
        return self._master < 0

    def unread(self) -> int:
        with self._writing, suppress(OSError):
            if not self.down:
                return int(struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)))[0])
        return 0

    def hang_up(self) -> None:
        """Close both ends; a connected driver sees a hang-up."""
        with self._writing:
            ends, self._master, self._slave = (self._master, self._slave), -1, -1
            if ends[0] >= 0:
                os.write(self._wake, b"!")
        if self._thread is not None and self._thread is not threading.current_thread():
            # A descriptor that is waited on stays open when closed: the driver would not see the hang-up.
            self._thread.join(timeout=_LOOK_S)
        for end in ends:
            if end >= 0:
                with suppress(OSError):
                    os.close(end)

    def close(self) -> None:
        super().close()
        with self._writing:
            ends, self._wakes, self._wake = (self._wakes, self._wake), -1, -1
        for end in ends:
            if end >= 0:
                os.close(end)

    def _serve(self, instrument: Served) -> None:
        while not self._over.is_set() and (master := self._master) >= 0:
            try:
                ready, _, _ = select.select([master, self._wakes], [], [], _LOOK_S)
                data = os.read(master, _READ_BYTES) if master in ready and self._master >= 0 else b""
            except BlockingIOError:
                continue
            except (OSError, ValueError) as error:
                if isinstance(error, OSError) and error.errno == errno.EIO and self._slave >= 0:
                    continue  # not open at the moment
                return
            if not data:
                continue
            reply = self._answer(instrument, data)
            if reply is None:
                return self.hang_up()
            self._write(master, reply)

    def _write(self, master: int, left: bytes) -> None:
        while left and not self._over.is_set():
            _, ready, _ = select.select([], [master], [], _LOOK_S)
            if ready:
                with self._writing, suppress(BlockingIOError):
                    left = left[os.write(master, left) :]


class TcpPort(Port):
    """A raw socket on the loopback for one driver at a time, like a LAN instrument."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._listening.settimeout(_LOOK_S)
        self._talking: socket.socket | None = None
        self.number = int(self._listening.getsockname()[1])
        self.address = f"TCPIP::127.0.0.1::{self.number}::SOCKET"

    def _send(self, data: bytes) -> None:
        if (talking := self._talking) is not None:
            with suppress(OSError):
                talking.sendall(data)

    @property
    def down(self) -> bool:
        return self._listening.fileno() < 0

    def hang_up(self) -> None:
        """Close the connection and accept no other."""
        for connection in (self._talking, self._listening):
            if connection is not None:
                # Closing alone would not wake the waiting thread.
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)
                with suppress(OSError):
                    connection.close()

    def _serve(self, instrument: Served) -> None:
        while not self._over.is_set():
            try:
                talking, _ = self._listening.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            with talking:
                talking.settimeout(_LOOK_S)
                talking.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._talking = talking
                self._talk(talking, instrument)

    def _talk(self, talking: socket.socket, instrument: Served) -> None:
        while not self._over.is_set():
            try:
                data = talking.recv(_READ_BYTES)
            except TimeoutError:
                continue
            except OSError:
                return
            if not data:
                return
            answer = self._answer(instrument, data)
            if answer is None:
                return self.hang_up()
            with suppress(OSError):
                talking.sendall(answer)
