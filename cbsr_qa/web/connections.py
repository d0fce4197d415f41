"""Connections to the server: every head of a request is timed, and those without the token share a few places.

Who has not shown the token takes no place of those who have: whoever has it is
always let in, and an emergency stop is answered.
"""

import asyncio
import socket
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Final

from uvicorn.protocols.http.h11_impl import H11Protocol

from cbsr_qa.web.guard import Right
from cbsr_qa.web.guesses import client_network
from cbsr_qa.web.line import MOST_LOOKERS, MOST_VIEWERS

#: How long the head of a request may take, from the opening of its connection or the answer before it [s].
HEAD_S: Final = 10.0
#: A client that takes nothing of what it is sent for so long is left [s].
SLOW_S: Final = 30.0
#: Largest head of a request [B].
MOST_HEAD: Final = 16_384
#: Places of connections without a right, and of those that may only look.
_PLACES: Final = {Right.NONE: 64, Right.LOOK: MOST_LOOKERS + 64}
#: A connection that the server has not looked at so often makes no room for another: its request may be on its way.
#: The looks are counted, and not the time, as a busy server looks less often.
_NEW_LOOKS: Final = 4
_LOOK_S: Final = 0.25
#: Connections that may be open while TLS is agreed on.
_MOST_HANDSHAKES: Final = 128
#: Connections that wait to be accepted, and that are accepted before others are read from.
_WAITING: Final = 2048
_ACCEPTED_AT_ONCE: Final = 32
#: Above so many, even new ones make room.
_MOST_NEW: Final = 256
#: Connections that may control, beside their open pages. More are answered with 503, as are all above the sum.
_MOST_CONTROL: Final = 128
MOST_CONNECTIONS: Final = _MOST_NEW + _PLACES[Right.LOOK] + MOST_VIEWERS + _MOST_CONTROL


class Connection(H11Protocol):
    """A connection that is closed if its next head is late, if it is not read from, or if others need its place."""

    def connection_made(self, transport: Any) -> None:
        self._opened_s = self.loop.time()
        self._first_look = getattr(self.loop, "looks", 0)
        self._right_before = Right.NONE
        self._late: asyncio.TimerHandle | None = None
        self._slow: asyncio.TimerHandle | None = None
        super().connection_made(transport)
        self.client_name = client_network(self.client[0]) if self.client else ""
        _HANDSHAKES.pop(transport.get_extra_info("socket").fileno(), None)
        self._await_head()
        self._make_room()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_waiting()
        self.resume_writing()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        answered = self.cycle
        super().data_received(data)
        if self.cycle is not answered and self.is_answering:
            self._stop_waiting()

    def on_response_complete(self) -> None:
        answered = self.cycle
        self._right_before = self.right
        super().on_response_complete()
        if self.cycle is answered:  # otherwise the next request is here already
            self._await_head()

    def pause_writing(self) -> None:
        self._slow = self.loop.call_later(SLOW_S, self._leave)
        super().pause_writing()

    def resume_writing(self) -> None:
        if self._slow is not None:
            self._slow.cancel()
            self._slow = None
        super().resume_writing()

    @property
    def right(self) -> Right:
        """The right of the latest request that was checked."""
        scope: Mapping[str, Any] | None = self.scope
        return self._right_before if scope is None else scope.get("cbsr_right", self._right_before)

    @property
    def is_answering(self) -> bool:
        """Whether a request has arrived whose answer is not complete."""
        return self.cycle is not None and not self.cycle.response_complete

    def _await_head(self) -> None:
        self._stop_waiting()
        self._late = self.loop.call_later(HEAD_S, self._leave)

    def _stop_waiting(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None

    def _leave(self) -> None:
        """Close without waiting for a client that does not read."""
        self.connections.discard(self)
        self.transport.abort()

    @property
    def _is_new(self) -> bool:
        return getattr(self.loop, "looks", 0) - self._first_look < _NEW_LOOKS

    def _make_room(self) -> None:
        """Close the oldest connections of the client that has most, until those that may not control have room."""
        for right, places in _PLACES.items():
            peers = [one for one in self.connections if isinstance(one, Connection) and one.right == right]
            if len(peers) <= places:
                continue
            by_client = Counter(one.client_name for one in peers)
            peers.sort(key=lambda one: (one.is_answering, -by_client[one.client_name], one._opened_s))
            leaving = [one for one in peers if not one._is_new][: len(peers) - places]
            staying = [one for one in peers if one not in leaving and one is not self]
            leaving += staying[: max(len(staying) - _MOST_NEW, 0)]
            for connection in leaving:
                connection._leave()


#: Accepted connections, by descriptor, that are not open yet as TLS is agreed on; the oldest first.
_HANDSHAKES: Final[dict[int, socket.socket]] = {}


class ListeningSocket(socket.socket):
    """A socket that listens, and cuts the oldest handshakes of TLS where there are too many."""

    def listen(self, backlog: int = _WAITING) -> None:
        super().listen(max(backlog, _WAITING))

    def accept(self) -> tuple[socket.socket, Any]:
        connection, address = super().accept()
        for number in [number for number, one in _HANDSHAKES.items() if one.fileno() != number]:
            del _HANDSHAKES[number]
        _HANDSHAKES[connection.fileno()] = connection
        while len(_HANDSHAKES) > _MOST_HANDSHAKES:
            with suppress(OSError):
                _HANDSHAKES.pop(next(iter(_HANDSHAKES))).shutdown(socket.SHUT_RDWR)
        return connection, address


class ServerLoop(asyncio.SelectorEventLoop):
    """An event loop whose servers time the handshake of TLS as they time heads.

    Attributes
    ----------
    looks : how often all connections had a chance to be read from, counted a few times a second.
    """

    looks = 0

    async def create_server(self, protocol_factory: Callable[[], Any], *args: Any, **options: Any) -> Any:
        if options.get("ssl"):
            options["ssl_handshake_timeout"] = HEAD_S
        self._count_looks()
        return await super().create_server(protocol_factory, *args, **options)

    def _count_looks(self) -> None:
        self.looks += 1
        self.call_later(_LOOK_S, self._count_looks)


def connection_settings() -> dict[str, Any]:
    """Return the settings of uvicorn that are about connections."""
    return {
        "http": Connection,
        "ws": "none",
        "h11_max_incomplete_event_size": MOST_HEAD,
        "limit_concurrency": MOST_CONNECTIONS,
        "timeout_keep_alive": HEAD_S,
        "backlog": _ACCEPTED_AT_ONCE,
        "proxy_headers": False,  # a header does not decide whose connection it is
    }
