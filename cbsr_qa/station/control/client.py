"""The other end of a run's channel, for commands. A page's event loop connects to the same socket itself."""

import json
import os
import socket
import time
from collections.abc import Iterator
from typing import Any, Final, Self

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.station.control.lock import control_socket, station_holder
from cbsr_qa.station.control.server import LONGEST_LINE
from cbsr_qa.system.json_text import parse_json

#: How long a run may take to answer [s].
PATIENCE_S: Final = 10.0


class RunChannel:
    """A connection to the run at a station; use it as a context manager.

    Attributes
    ----------
    hello : the first line, with the state.
    """

    def __init__(self, connection: socket.socket, timeout_s: float) -> None:
        self._connection, self._timeout_s = connection, timeout_s
        self._received, self._number = b"", 0
        self.hello: dict[str, Any] = next(self.lines(), {"type": "refused", "why": "the run has ended"})
        if self.hello.get("type") != "hello":
            raise RefusedError(str(self.hello.get("why") or "the run's channel does not begin with a hello"))

    @classmethod
    def connect(cls, station: str, *, timeout_s: float = PATIENCE_S) -> Self:
        """Connect to the run at a station.

        Raises
        ------
        RefusedError
            If no run is there, it has no channel, it belongs to another user, or it does not answer in time.
        """
        path = control_socket(station)
        if path.parent.exists() and path.exists() and path.lstat().st_uid != os.getuid():
            raise RefusedError(f"the run at station {station!r} belongs to another user")
        connection = socket.socket(socket.AF_UNIX)
        try:
            connection.settimeout(timeout_s)
            connection.connect(str(path))
            return cls(connection, timeout_s)
        except OSError as error:
            connection.close()
            raise _unreachable(station, error) from error
        except BaseException:
            connection.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def ask(self, do: str, *, by: str = "", **what: Any) -> dict[str, Any]:
        """Make a request and return the reply; events that arrive meanwhile are dropped.

        Raises
        ------
        RefusedError
            If the run refuses it or does not answer in time.
        """
        self._number += 1
        request = {"id": self._number, "do": do, "by": by, **what}
        try:
            self._connection.sendall(json.dumps(request).encode() + b"\n")
            for line in self.lines():
                if line.get("type") == "reply" and line.get("id") == self._number:
                    if line.get("ok") is not True:
                        raise RefusedError(
                            str(line.get("why") or "the run answers without saying whether it does it")
                        )
                    return line
        except OSError as error:
            raise RefusedError(f"the run does not answer: {error.strerror or error}") from error
        raise RefusedError("the run has ended")

    def lines(self) -> Iterator[dict[str, Any]]:
        """Yield every line until the run closes the channel.

        Raises
        ------
        TimeoutError
            If none arrives in time.
        """
        until_s = time.monotonic() + self._timeout_s
        while True:
            line, newline, rest = self._received.partition(b"\n")
            if newline:
                self._received = rest
                yield _message(line)
                until_s = time.monotonic() + self._timeout_s
                continue
            self._connection.settimeout(max(until_s - time.monotonic(), 0.001))
            more = self._connection.recv(1 << 16)
            if not more or len(self._received) > LONGEST_LINE:
                return
            self._received += more


def _message(line: bytes) -> dict[str, Any]:
    try:
        message = parse_json(line)
    except ValueError as error:
        raise RefusedError(f"the run's channel sent a line that is not JSON: {error}") from error
    if not isinstance(message, dict):
        raise RefusedError("the run's channel sent a line that is not a JSON object")
    return message


def _unreachable(station: str, error: OSError) -> RefusedError:
    holder = station_holder(station)
    if holder is None:
        return RefusedError(
            f"no run is under way at station {station!r}",
            remedy="runs are found if CBSR_QA_VAR names the same folder as for the run",
        )
    return RefusedError(
        f"station {station!r} is in use ({holder.words}), but it cannot be reached: {error.strerror or error}",
        remedy="only a run can be paused; cbsr-qa station stop stops any command by a signal",
    )
