"""A serial port whose every failure is an InstrumentError that names the role and the address."""

import errno
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import serial
from serial.tools import list_ports

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.plugin.links.locks import AddressLock
from cbsr_qa.plugin.links.taps import current_tap
from cbsr_qa.plugin.links.transcript import quote
from cbsr_qa.system.clock import RealClock

_USB: Final = "usb:"
#: A waiting reader lets others have the line this often [s, real time].
_SLICE_S: Final = 0.02
#: How long a port may not take any bytes: only a driver of the system that hangs does [s, real time].
_WRITE_S: Final = 3.0
#: No instrument of a bench sends longer lines; what does is not the instrument that was expected.
_MAX_LINE_BYTES: Final = 4096
#: Bytes without a line end of which the last are quoted.
_QUOTED: Final = 12


class SerialLink:
    """An open serial port; its methods may be called from several threads.

    Timeouts are real time, whatever the station's clock. Bytes of an answer that stayed incomplete are kept for the
    next reading, so that nothing is lost where an instrument is merely slow; :meth:`flush_input` throws them away.
    ConfigError if the address is no usb: address though it begins like one; InstrumentError if there is no such port
    or device, it may not be opened, or another program has it.

    Parameters
    ----------
    address : path of the port, or ``usb:VID:PID`` or ``usb:VID:PID:SERIAL`` (hexadecimal, as in ``usb:2C99:0002``):
        a device by its identity, whatever port it is plugged into.
    baud : bits per second; 8 data bits, no parity, 1 stop bit.
    timeout_s : default time to wait for an answer.
    """

    def __init__(self, role: str, address: str, *, baud: int, timeout_s: float = 1.0) -> None:
        self.role = role
        self.address = address
        self.timeout_s = timeout_s
        self._baud = baud
        #: Whether the line was found to be down; only reopening mends that.
        self.down = False
        self._time = RealClock()
        self._held = bytearray()
        self._reading = threading.RLock()
        self._writing = threading.Lock()
        self._lock: AddressLock | None = None
        self._port = self._open_port()

    @property
    def port(self) -> str:
        return str(self._port.port)

    def write(self, data: bytes) -> None:
        """Send all of this. InstrumentError if the line is down, or does not take the bytes in time (retryable)."""
        with self._writing, self._convert_errors():
            sent = self._port.write(data)
        if sent is not None and sent < len(data):
            raise self.error(f"took {sent} of {len(data)} bytes within {_WRITE_S:g} s", retryable=True)

    def read(self, count: int, timeout_s: float | None = None) -> bytes:
        """Return exactly so many bytes.

        InstrumentError if they do not come in time (retryable), or the line is down.
        """
        allowed_s = self.timeout_s if timeout_s is None else timeout_s
        for _ in self._filling(allowed_s):
            with self._reading:
                if len(self._held) >= count:
                    return self._take(count)
        reason = f"answered {len(self._held)} of {count} bytes within {allowed_s:.3g} s"
        raise self.error(reason, remedy=_SILENT, retryable=True)

    def read_line(self, timeout_s: float | None = None) -> bytes:
        r"""Return the next line without its end (``\n`` or ``\r\n``).

        InstrumentError if no whole line comes in time (retryable), it does not end, or the link is down.
        """
        allowed_s = self.timeout_s if timeout_s is None else timeout_s
        for _ in self._filling(allowed_s):
            with self._reading:
                end = self._held.find(b"\n")
                if end >= 0:
                    return self._take(end + 1).rstrip(b"\r\n")
                if len(self._held) > _MAX_LINE_BYTES:
                    came = describe_partial_line(self._take(len(self._held)))
                    raise self.error(f"sent {came}", remedy=_BAUD)
        came, remedy = (describe_partial_line(self.partial_line), _BAUD) if self._held else ("nothing", _SILENT)
        raise self.error(f"answered {came} within {allowed_s:.3g} s", remedy=remedy, retryable=True)

    @property
    def partial_line(self) -> bytes:
        """What came and belongs to no whole line or answer yet; it stays there."""
        with self._reading:
            return bytes(self._held)

    def read_available(self) -> bytes:
        """Return what has come, without waiting; may be nothing."""
        with self._reading:
            self._receive(0.0)
            return self._take(len(self._held))

    def flush_input(self) -> None:
        with self._reading, self._convert_errors():
            self._held.clear()
            self._port.reset_input_buffer()

    def reopen(self) -> None:
        """Give the port back and open it again: a usb: address where the device is plugged in now.

        InstrumentError if it cannot be opened.
        """
        self.close()
        with self._reading:
            self._held.clear()
            self._port = self._open_port()
            self.down = False

    def close(self) -> None:
        """Give the port back; may be called more than once."""
        self._port.close()
        if self._lock is not None:
            self._lock.release()

    def _take(self, count: int) -> bytes:
        data = bytes(self._held[:count])
        del self._held[:count]
        return data

    def _filling(self, allowed_s: float) -> Iterator[None]:
        """Yield after every reception, the first time at once, until the time is over."""
        until_s = self._time.now() + allowed_s
        yield
        while (left_s := until_s - self._time.now()) > 0:
            self._receive(min(left_s, _SLICE_S))
            yield

    def _receive(self, wait_s: float) -> None:
        with self._reading, self._convert_errors():
            waiting = self._port.in_waiting
            if not waiting and wait_s <= 0:
                return
            if self._port.timeout != wait_s:
                self._port.timeout = wait_s
            self._held += self._port.read(max(waiting, 1))

    def _open_port(self) -> serial.Serial:
        tap = current_tap()
        port: serial.Serial = self._open_real_port() if tap is None else tap.connect(self.role, self._open_real_port)
        return port

    def _open_real_port(self) -> serial.Serial:
        path = self._path()
        self._lock = lock = AddressLock(self.role, path)
        try:
            return serial.Serial(path, self._baud, timeout=self.timeout_s, write_timeout=_WRITE_S, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            lock.release()
            raise self._opening_error(path, error) from error

    def _path(self) -> str:
        """Return the path of the port, where a usb: device is plugged in at the moment."""
        if not self.address.lower().startswith(_USB):
            return self.address
        vid, pid, number = _usb_identity(self.role, self.address)
        matching_ports = [
            port
            for port in list_ports.comports()
            if (port.vid, port.pid) == (vid, pid) and number in (None, port.serial_number)
        ]
        if len(matching_ports) == 1:
            return str(matching_ports[0].device)
        if not matching_ports:
            raise self.error("no such device is plugged in", remedy=_ports())
        serials = {port.serial_number for port in matching_ports} - {None, ""}
        remedy = "say which by its serial number: usb:VID:PID:SERIAL"
        if len(serials) < len(matching_ports):
            remedy = "their serial numbers do not tell them apart: give the port's path, /dev/serial/by-path/…"
        devices = ", ".join(sorted(port.device for port in matching_ports))
        raise self.error(f"{len(matching_ports)} such devices are plugged in ({devices})", remedy=remedy)

    def _opening_error(self, path: str, error: Exception) -> InstrumentError:
        number = getattr(error, "errno", None)
        if number in (errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY) or "lock" in str(error).lower():
            return self.error("another program has the port", remedy="end the other program, or wait for it")
        if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
            return self.error(f"there is no port {path}", remedy=_ports())
        if number in (errno.EACCES, errno.EPERM):
            return self.error(
                f"port {path} may not be opened", remedy="add the user to the group that owns it (often dialout)"
            )
        return self.error(f"port {path} does not open: {error}", remedy=_ports())

    @contextmanager
    def _convert_errors(self) -> Iterator[None]:
        try:
            yield
        except serial.SerialTimeoutException as error:
            reason = f"took no more bytes for {_WRITE_S:g} s"
            raise self.error(reason, remedy=_SILENT, retryable=True) from error
        except serial.PortNotOpenError as error:
            self.down = True
            raise self.error("the link is closed") from error
        except (serial.SerialException, OSError, TypeError, ValueError) as error:
            self.down = True
            if not self._port.is_open:  # pyserial leaks a TypeError where it is closed
                raise self.error("the link is closed") from error
            raise self.error(f"the link is down ({error})", remedy=_CABLE) from error

    def error(self, reason: str, remedy: str = "", *, retryable: bool = False) -> InstrumentError:
        return InstrumentError(self.role, self.address, reason, remedy=remedy, retryable=retryable)


_SILENT: Final = "check that it is switched on, and its baud rate"
_BAUD: Final = "check the address, the baud rate, and which line end it sends"
_CABLE: Final = "check the cable and the power of the instrument"


def describe_partial_line(data: bytes) -> str:
    r"""Count the bytes of a line that does not end, and quote the last; lines that end in ``\r`` alone are named."""
    is_text = all(32 <= byte < 127 or byte in b"\r\t" for byte in data)
    kind = "whose lines end in \\r, not in \\n" if is_text and b"\r" in data else "without a line end"
    return f"{len(data)} bytes {kind}, the last {quote(data[-_QUOTED:])}"


def _usb_identity(role: str, address: str) -> tuple[int, int, str | None]:
    """Return vendor, product and serial number; None where any will do."""
    vendor, _, rest = address[len(_USB) :].partition(":")
    product, _, number = rest.partition(":")
    try:
        return int(vendor, 16), int(product, 16), number or None
    except ValueError as error:
        raise ConfigError(
            f"instrument {role!r}: address {address!r} is not a USB device",
            remedy='write usb:VID:PID or usb:VID:PID:SERIAL in hexadecimal, e.g. "usb:2C99:0002"',
        ) from error


def _ports() -> str:
    """List the ports, with the identity of USB devices."""
    known = [
        f"{port.device} (usb:{port.vid:04X}:{port.pid:04X}{f':{port.serial_number}' if port.serial_number else ''})"
        for port in list_ports.comports()
        if port.vid is not None and port.pid is not None
    ]
    return f"plug it in; USB serial ports found: {', '.join(sorted(known)) or 'none'}"
