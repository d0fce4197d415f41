"""Connections before TLS is agreed on: nothing is computed for a connection until its hello is complete.

An incomplete hello costs the server an open file and little else, so that many of them delay no other client.
"""

import asyncio
import resource
import socket
import ssl
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

from cbsr_qa.web.connections import HEAD_S

#: Number of connections that may wait at the system to be accepted.
_BACKLOG: Final = 2048
#: Buffer of the system for a connection that is not read yet [B]; the system doubles it.
_KEPT: Final = 32_768
#: Most connections whose hello is not complete, and number of files that are left for others.
_MAX_WAITING: Final = 512
_OTHER_FILES: Final = 64
#: Age at which a connection makes room for another if all places are taken [s]; until then the other waits.
_SPARED_S: Final = 0.25
#: Most handshakes under way. If there are as many, the oldest makes room for the next from this age on [s]:
#: an honest one has ended by then.
_MAX_HANDSHAKES: Final = 256
_AGREED_S: Final = 0.4
#: Number of handshakes begun before connections are read from again.
_BEGUN_AT_ONCE: Final = 8
_ACCEPTED_AT_ONCE: Final = 64
#: Interval between looks whether a place is free [s].
_LOOK_S: Final = 0.02
#: A record of TLS (RFC 8446, 5.1): type, version and length, then so many bytes.
_HEADER: Final = 5
_HANDSHAKE: Final = b"\x16\x03"
_MAX_RECORD_BYTES: Final = 2**14
_SWEEP_S: Final = 1.0


class Reception:
    """A server of asyncio that accepts connections, and passes them on once the client's hello is complete.

    Parameters
    ----------
    listening : listening socket that does not block.
    protocol_factory : function that makes the protocol of a connection.
    context : settings of TLS.
    """

    def __init__(
        self, listening: socket.socket, protocol_factory: Callable[[], Any], context: ssl.SSLContext
    ) -> None:
        self.sockets = (listening,)
        self._listening, self._number = listening, listening.fileno()
        self._factory, self._context = protocol_factory, context
        self._loop = asyncio.get_running_loop()
        self._waiting: dict[socket.socket, float] = {}  # connection → time of arrival [s], the oldest first
        self._greeted: deque[socket.socket] = deque()  # connections with a complete hello
        self._handshakes: dict[
            asyncio.Task[None], tuple[socket.socket, float]
        ] = {}  # task → connection and start [s]
        self._begins: asyncio.Handle | None = None
        self._again: asyncio.TimerHandle | None = None
        soft_limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        self._places = _MAX_WAITING if soft_limit < 0 else max(min(_MAX_WAITING, soft_limit // 2 - _OTHER_FILES), 16)
        self._listen()
        self._sweep_later = self._loop.call_later(_SWEEP_S, self._sweep)

    def close(self) -> None:
        """Accept no more connections, and close all that wait."""
        self._sweep_later.cancel()
        if self._again is not None:
            self._again.cancel()
        if self._begins is not None:
            self._begins.cancel()
        self._loop.remove_reader(self._number)
        for connection in [*self._waiting, *self._greeted]:
            self._leave(connection)
        self._greeted.clear()

    async def wait_closed(self) -> None:
        """Wait for the handshakes under way."""
        await asyncio.gather(*self._handshakes, return_exceptions=True)

    def _listen(self) -> None:
        self._again = None
        self._loop.add_reader(self._number, self._accept)

    def _listen_later(self, delay_s: float) -> None:
        self._loop.remove_reader(self._number)
        self._again = self._loop.call_later(delay_s, self._listen)

    def _accept(self) -> None:
        for _ in range(_ACCEPTED_AT_ONCE):
            if len(self._waiting) + len(self._greeted) >= self._places:
                oldest, since_s = next(iter(self._waiting.items()), (None, self._loop.time()))
                left_s = since_s + _SPARED_S - self._loop.time()
                if oldest is None or left_s > 0:
                    self._listen_later(min(left_s, _LOOK_S))
                    return
                self._leave(oldest)
            try:
                connection, _ = self._listening.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError:  # no more files may be open
                if self._waiting:
                    self._leave(next(iter(self._waiting)))
                self._listen_later(_SPARED_S)
                return
            connection.setblocking(False)
            self._waiting[connection] = self._loop.time()
            self._wait_for(connection, _HEADER)

    def _wait_for(self, connection: socket.socket, count: int) -> None:
        """Look at a connection once this number of bytes has arrived, or its end."""
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, count)
        self._loop.add_reader(connection, self._look_at, connection, count)

    def _look_at(self, connection: socket.socket, awaited: int) -> None:
        try:
            hello = connection.recv(awaited, socket.MSG_PEEK)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            hello = b""
        record_size = _HEADER + int.from_bytes(hello[3:_HEADER], "big")
        if len(hello) < awaited or not hello.startswith(_HANDSHAKE) or record_size > _MAX_RECORD_BYTES:
            self._leave(connection)
        elif len(hello) < record_size:
            self._wait_for(connection, record_size)
        else:
            self._loop.remove_reader(connection)
            del self._waiting[connection]
            self._greeted.append(connection)
            if self._begins is None:
                self._begins = self._loop.call_soon(self._begin)

    def _begin(self) -> None:
        """Begin the handshakes that are due, in the order of arrival."""
        self._begins = None
        for _ in range(min(_BEGUN_AT_ONCE, len(self._greeted))):
            if len(self._handshakes) >= _MAX_HANDSHAKES:
                task, (oldest, since_s) = next(iter(self._handshakes.items()))
                left_s = since_s + _AGREED_S - self._loop.time()
                if left_s > 0:
                    self._begins = self._loop.call_later(min(left_s, _LOOK_S), self._begin)
                    return
                del self._handshakes[task]
                with suppress(OSError):
                    oldest.shutdown(socket.SHUT_RDWR)
            connection = self._greeted.popleft()
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, 1)
            task = self._loop.create_task(self._agree(connection))
            self._handshakes[task] = connection, self._loop.time()
            task.add_done_callback(lambda ended: self._handshakes.pop(ended, None))
        if self._greeted:
            self._begins = self._loop.call_soon(self._begin)

    async def _agree(self, connection: socket.socket) -> None:
        try:
            await self._loop.connect_accepted_socket(
                self._factory, connection, ssl=self._context, ssl_handshake_timeout=HEAD_S
            )
        except (OSError, asyncio.CancelledError):  # errors of TLS are OSError too
            connection.close()

    def _leave(self, connection: socket.socket) -> None:
        self._loop.remove_reader(connection)
        self._waiting.pop(connection, None)
        connection.close()

    def _sweep(self) -> None:
        """Close the connections whose hello is late."""
        late_s = self._loop.time() - HEAD_S
        for connection in [one for one, since_s in self._waiting.items() if since_s < late_s]:
            self._leave(connection)
        self._sweep_later = self._loop.call_later(_SWEEP_S, self._sweep)


class ServerLoop(asyncio.SelectorEventLoop):
    """An event loop whose servers receive connections of TLS through a :class:`Reception`."""

    async def create_server(self, protocol_factory: Callable[[], Any], *args: Any, **options: Any) -> Any:
        """Return a server; for TLS, a :class:`Reception` on the given socket."""
        if not options.get("ssl"):
            return await super().create_server(protocol_factory, *args, **options)
        listening = options["sock"]
        listening.setblocking(False)
        return Reception(listening, protocol_factory, options["ssl"])


class ListeningSocket(socket.socket):
    """A socket with a long queue of connections and a small buffer for each, whatever ``listen`` is asked for."""

    def listen(self, backlog: int = _BACKLOG) -> None:
        self.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _KEPT)  # its connections inherit it
        super().listen(max(backlog, _BACKLOG))
