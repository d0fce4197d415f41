"""Readers of a stream as lines of JSON: standard output, and whoever connects to a TCP or Unix socket.

Each has a queue and a thread of its own (``Delivery``): one that is slow, or has gone,
loses its oldest messages and delays nobody.
"""

import os
import socket
import stat
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Self

from cbsr_qa.app.stream.messages import AliveMessage, DroppedMessage, HeaderMessage, StreamMessage, json_line
from cbsr_qa.domain.errors import DeliveryError, RefusedError
from cbsr_qa.station.event_sinks import Delivery

#: Largest number of messages that wait for a client; beyond it the oldest are dropped.
LARGEST_QUEUE: Final = 250
#: Largest number of clients of one socket; further ones are turned away.
MOST_CLIENTS: Final = 32
#: Time to wait for the last messages [s].
END_S: Final = 2.0
#: Time that a client may not read before it is cut off [s].
_STUCK_S: Final = 30.0
#: Size of the send buffer [bytes]: small, so that a slow client does not read old messages.
_BUFFER_BYTES: Final = 65536

Tell = Callable[[str], None]


class _Lines:
    """A sink that writes messages as lines of JSON, and says how many were dropped before."""

    largest_batch = 100

    def __init__(
        self, write: Callable[[bytes], None], close: Callable[[], None], over: Callable[[str], None]
    ) -> None:
        self._write, self._close, self._over = write, close, over
        self._before: int | None = None
        self._dropped = 0
        self._gone = ""

    def deliver(self, messages: Sequence[Mapping[str, Any]]) -> None:
        if self._gone:
            raise DeliveryError(self._gone, final=True)
        lines = [part for message in messages for part in self._parts(message["message"])]
        try:
            self._write(b"".join(lines))
        except OSError as error:
            self._gone = "it has gone" if isinstance(error, ConnectionError) else error.strerror or str(error)
            self._close()
            self._over(self._gone)
            raise DeliveryError(self._gone, final=True) from error

    def close(self) -> None:
        self._close()

    def _parts(self, message: StreamMessage) -> list[bytes]:
        line = json_line(message)
        if isinstance(message, HeaderMessage | AliveMessage):
            return [line]
        lost_count = 0 if self._before is None else message.sequence - self._before - 1
        self._before = message.sequence
        if not lost_count:
            return [line]
        self._dropped += lost_count
        return [
            json_line(DroppedMessage("dropped", message.sequence, message.serial, lost_count, self._dropped)),
            line,
        ]


class _Client:
    """One reader of lines."""

    def __init__(self, name: str, write: Callable[[bytes], None], close: Callable[[], None]) -> None:
        self.over = ""
        self._delivery = Delivery(name, _Lines(write, close, self._note_end), most=LARGEST_QUEUE)

    def send(self, message: StreamMessage) -> None:
        self._delivery.put({"message": message})

    def close(self) -> None:
        self._delivery.end()
        self._delivery.wait(END_S)

    def end(self) -> None:
        """Let its thread end."""
        self._delivery.end()

    def _note_end(self, why: str) -> None:
        self.over = why


class StandardOutput(_Client):
    """The one reader behind a pipe."""

    def __init__(self, write: Callable[[bytes], None], tell: Tell) -> None:
        super().__init__("stream to standard output", write, lambda: None)
        self._tell = tell

    def close(self) -> None:
        super().close()
        loss = self._delivery.describe_loss()
        if loss and not self.over:
            self._tell(loss)

    def _note_end(self, why: str) -> None:
        self.over = f"standard output: {why}"


class Server:
    """Listens, and sends every client the header and what follows."""

    over = ""

    def __init__(self, listening: socket.socket, address: str, tell: Tell, removes: Path | None = None) -> None:
        self._listening, self._address, self._tell, self._removes = listening, address, tell, removes
        self._lock = threading.Lock()
        self._header: StreamMessage | None = None
        self._clients: list[_Client] = []
        self._closing = False
        threading.Thread(target=self._accept, name=f"stream at {address}", daemon=True).start()
        tell(f"streaming at {address}")

    @classmethod
    def tcp(cls, host: str, port: int, tell: Tell) -> Self:
        try:
            family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
            listening = socket.create_server(address[:2], family=family)
        except OSError as error:
            raise _unusable(f"tcp://{host}:{port}", error, "name another port, or 0 for any that is free") from error
        shown_host = f"[{host}]" if ":" in host else host
        return cls(listening, f"tcp://{shown_host}:{listening.getsockname()[1]}", tell)

    @classmethod
    def unix(cls, path: Path, tell: Tell) -> Self:
        listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            _remove_dead(path)
            listening.bind(os.fspath(path))
            listening.listen()
        except (OSError, ValueError) as error:
            listening.close()
            raise _unusable(f"unix:{path}", error, "name another path, in a folder that exists") from error
        return cls(listening, f"unix:{path}", tell, path)

    def send(self, message: StreamMessage) -> None:
        with self._lock:
            if isinstance(message, HeaderMessage):
                self._header = message
            for client in self._clients:
                client.send(message)
            for client_over in [client for client in self._clients if client.over]:
                self._clients.remove(client_over)
                client_over.end()

    def close(self) -> None:
        with self._lock:
            self._closing = True
            clients = list(self._clients)
        with suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts
        self._listening.close()
        if self._removes is not None:
            self._removes.unlink(missing_ok=True)
        for client in clients:
            client.end()
        for client in clients:
            client.close()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listening.accept()
            except OSError:
                if self._closing:
                    return
                time.sleep(0.1)  # a connection that was cut off at once, or too many open files
                continue
            self._join(connection)

    def _join(self, connection: socket.socket) -> None:
        connection.settimeout(_STUCK_S)
        with suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
            if connection.family != socket.AF_UNIX:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with self._lock:
            if self._closing or len(self._clients) >= MOST_CLIENTS:
                connection.close()
                return
            client = _Client(f"client of {self._address}", connection.sendall, connection.close)
            self._clients.append(client)
            if self._header is not None:
                client.send(self._header)


def _remove_dead(path: Path) -> None:
    """Remove the socket that a killed process has left behind."""
    if not (path.exists() and stat.S_ISSOCK(path.stat().st_mode)):
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(os.fspath(path))
        except ConnectionRefusedError:
            path.unlink()


def _unusable(place: str, error: Exception, remedy: str) -> RefusedError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return RefusedError(f"nothing can be served at {place}: {reason}", remedy=remedy)
