"""A VISA resource whose every failure is an InstrumentError that names the role and the address."""

import itertools
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final

import numpy as np
import pyvisa
from pyvisa import rname
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin.links.locks import AddressLock
from cbsr_qa.plugin.links.taps import current_tap, is_replaying
from cbsr_qa.system.clock import RealClock

#: A resynchronisation waits this many times the timeout for its token: the late answer comes first.
_PATIENCE: Final = 4.0
_HEADER: Final = b"#0"
_SINGLE: Final = "<f4"

_SILENT: Final = "check that it is switched on and not busy, and its address"
_SLOW: Final = f"{_SILENT}, or raise 'timeout_s' in its table"
_CABLE: Final = "check the cable and the power of the instrument"
_EXAMPLE: Final = 'write a VISA resource, e.g. "TCPIP::192.168.0.5::5025::SOCKET"'

#: Libraries that pyvisa-py needs, by the interface that a resource names first.
_LIBRARIES: Final = {
    "USB": "pip install pyusb, and install the system's libusb 1.0",
    "GPIB": "install linux-gpib and its Python module, or pip install gpib-ctypes beside the card's own driver",
}

#: Managers by backend. They are never closed: that would close the sessions of every instrument.
_managers: dict[str, Any] = {}


class VisaLink:
    """An open session with an instrument that answers line by line.

    Timeouts are real time, whatever the station's clock. An answer that stays out, is cut short or carries another
    mark than its question leaves the link out of step: :meth:`recover` brings it back. It is for one thread at a
    time; :meth:`write` alone may be called by another while the first waits for an answer. ConfigError if the address
    is not a VISA resource, or the backend is not installed. InstrumentError if another program has the resource, or
    it cannot be opened. A refused TCP port shows only at the first question.

    Parameters
    ----------
    timeout_s : default time to wait for an answer.
    echo : command, with ``{}`` for a word, that the instrument answers with that word alone.
    backend : of pyvisa: ``"@py"``, or ``"@ivi"`` for a vendor's library.
    """

    def __init__(
        self, role: str, address: str, *, timeout_s: float = 1.0, echo: str = 'print("{}")', backend: str = "@py"
    ) -> None:
        self.role = role
        self.address = address
        self.timeout_s = timeout_s
        self._echo = echo
        self._backend = backend
        self._time = RealClock()
        self._words = itertools.count(1)
        self._down = False
        self._lock = None if is_replaying() else AddressLock(role, address, device=_device(address))
        try:
            self._resource = self._open_resource()
        except BaseException:
            self._release()
            raise

    def write(self, text: str) -> None:
        """Send one line. InstrumentError if the link is down (retryable: it is opened again by :meth:`recover`)."""
        with self._convert_errors():
            self._resource.write_raw(text.encode("ascii") + b"\n")

    def query(self, text: str, *, mark: str = "") -> str:
        """Send one line and return the one that answers it, without mark and line end.

        InstrumentError if no line comes in time, or one with another mark (both retryable), or the link is down.
        ``mark``: word the answer must begin with, followed by a tab or nothing.
        """
        self.write(text)
        line = self._line()
        if not mark:
            return line
        found_mark, _, rest = line.partition("\t")
        if found_mark != mark:
            raise self.error(f"answered {line[:80]!r} to {text!r}, which is marked {mark!r}", retryable=True)
        return rest

    def query_binary(self, text: str, count: int, *, mark: str = "") -> Array:
        """Send one line and return the numbers that answer it.

        They are read by their length: a line end may occur within them. Returns (count,) float64. InstrumentError if
        they do not come whole and in time, or another line follows (both retryable), or the link is down.

        Parameters
        ----------
        count : of the numbers, sent as ``#0`` and little-endian singles, then a line end.
        mark : a separate line that must follow them.
        """
        self.write(text)
        size = len(_HEADER) + count * np.dtype(_SINGLE).itemsize
        with self._convert_errors():
            data = bytes(self._resource.read_bytes(size + 1 + (len(mark) + 1 if mark else 0)))
        if not data.startswith(_HEADER) or data[size : size + 1] != b"\n":
            raise self.error(f"answered {data[:16]!r}, not {count} binary numbers", retryable=True)
        if mark and data[size + 1 :] != mark.encode("ascii") + b"\n":
            other_mark = data[size + 1 : -1]
            raise self.error(f"answered question {other_mark!r} where {mark!r} was asked", retryable=True)
        return np.frombuffer(data, _SINGLE, count, len(_HEADER)).astype(np.float64)

    def recover(self) -> None:
        """Open the link again if it is down, and get back into step.

        InstrumentError if it cannot be opened (retryable: a cable may be put back), or there is no answer at all.
        """
        if not self._down:
            try:
                return self.resynchronise()
            except InstrumentError:
                if not self._down:  # a link that hung up shows only when it is written to
                    raise
        with suppress(Exception):
            self._resource.close()
        self._resource = self._open_resource()
        self._down = False
        self.resynchronise()

    def resynchronise(self) -> None:
        """Discard pending answers: send a word, and read until it comes back.

        InstrumentError if the word does not come back.
        """
        word = f"in-step-{next(self._words)}"
        self.write(self._echo.format(word))
        until_s = self._time.now() + _PATIENCE * self.timeout_s
        while self._time.now() < until_s:
            with suppress(_LateError):
                if self._line().endswith(word):
                    return
        raise self.error(f"no answer within {_PATIENCE * self.timeout_s:.3g} s", remedy=_SLOW)

    def close(self) -> None:
        """Give the resource back; may be called more than once."""
        with suppress(Exception):  # a session that was lost cannot be closed any more
            self._resource.close()
        self._release()

    def _release(self) -> None:
        if self._lock is not None:
            self._lock.release()

    def _line(self) -> str:
        with self._convert_errors():
            return bytes(self._resource.read_raw()).decode("ascii", "replace").rstrip("\r\n")

    def _open_resource(self) -> Any:
        tap = current_tap()
        return self._open_real_resource() if tap is None else tap.connect(self.role, self._open_real_resource)

    def _open_real_resource(self) -> Any:
        try:
            if self._backend not in _managers:
                _managers[self._backend] = pyvisa.ResourceManager(self._backend)
        except (ValueError, OSError) as error:
            raise ConfigError(
                f"instrument {self.role!r}: there is no VISA backend {self._backend!r} ({error})",
                remedy='leave the option out for "@py", or install the vendor\'s VISA library',
            ) from error
        try:
            resource = _managers[self._backend].open_resource(
                self.address, timeout=1e3 * self.timeout_s, open_timeout=round(1e3 * self.timeout_s)
            )
            resource.read_termination = "\n"
        except Exception as error:
            address_codes = (StatusCode.error_invalid_resource_name, StatusCode.error_invalid_setup)
            if isinstance(error, AttributeError) or getattr(error, "error_code", None) in address_codes:
                reason = f"instrument {self.role!r}: {self.address!r} is not a VISA resource"
                raise ConfigError(reason, remedy=_EXAMPLE) from error
            raise self._opening_error(error) from error
        return resource

    def _opening_error(self, error: Exception) -> InstrumentError:
        """Return why a resource does not open; a library or a name that is missing is no matter of its power."""
        if "Please install" in str(error):
            kind = self.address.upper()
            remedy = next((words for name, words in _LIBRARIES.items() if kind.startswith(name)), str(error))
            return self.error("the library for this kind of address is not installed", remedy=remedy)
        if unknown := _find_unknown_host(self.address):
            remedy = "check its spelling, or write the instrument's IP address, which its menu shows"
            reason = f"no computer or instrument {unknown!r} is known to this network"
            return self.error(reason, remedy=remedy, retryable=True)  # its cable may be put back
        return self.error(f"it does not open: {error}", remedy=_SILENT, retryable=True)

    @contextmanager
    def _convert_errors(self) -> Iterator[None]:
        """Convert errors of pyvisa and the libraries below it to one error."""
        try:
            yield
        except VisaIOError as error:
            if error.error_code == StatusCode.error_timeout:
                reason = f"no answer within {self.timeout_s:.3g} s"
                raise _LateError(self.role, self.address, reason, remedy=_SLOW, retryable=True) from error
            raise self._link_error(error) from error
        except ConnectionRefusedError as error:
            self._down = True
            reason = "nothing listens there (connection refused)"
            raise self.error(reason, remedy=_SILENT, retryable=True) from error
        except (pyvisa.Error, OSError, AttributeError, TypeError, ValueError) as error:
            # A session that another thread closes while it is read leaks AttributeError or ValueError.
            raise self._link_error(error) from error

    def _link_error(self, error: Exception) -> InstrumentError:
        self._down = True
        return self.error(f"the link is down ({error})", remedy=_CABLE, retryable=True)

    def error(self, reason: str, remedy: str = "", *, retryable: bool = False) -> InstrumentError:
        return InstrumentError(self.role, self.address, reason, remedy=remedy, retryable=retryable)


def _find_unknown_host(address: str) -> str:
    """Return the host that an address names if the network does not know it; else empty."""
    with suppress(ValueError):
        host = getattr(rname.ResourceName.from_string(address), "host_address", "")
        try:
            socket.getaddrinfo(host or None, 0)
        except OSError:
            return str(host)
    return ""


def _device(address: str) -> str:
    """Return what a resource is locked by: parts that may be left out are added, and a serial port is its path."""
    try:
        resource = rname.ResourceName.from_string(address)
    except ValueError:
        return address  # it will not open
    board = str(getattr(resource, "board", ""))
    return board if board.startswith("/") else str(resource)


class _LateError(InstrumentError):
    """No answer came in time."""
