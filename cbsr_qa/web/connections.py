"""Connections to the server: every head of a request is timed, and clients without the token are read in turn.

A client that shows the token is read at once, and within no limit (:mod:`cbsr_qa.web.connection_limits`), so
that an emergency stop is answered before the requests of clients without it. The benchmark
``benchmarks/emergency_stops.py`` measures the delay under load; see ``docs/how-to/run-a-line.md``.
"""

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final, cast

from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.h11_impl import H11Protocol

from cbsr_qa.web.connection_limits import MAX_NEW, MAX_OPEN, ConnectionLimiter, LimitedConnection
from cbsr_qa.web.guard import Right
from cbsr_qa.web.guesses import client_network
from cbsr_qa.web.line import MAX_VIEWERS

#: Longest time for the head of a request, from the opening of its connection or the previous answer [s].
HEAD_S: Final = 10.0
#: Time after which the connection to a client that reads nothing is closed [s].
SLOW_S: Final = 30.0
#: Largest head of a request [B].
MAX_HEAD_BYTES: Final = 16_384
#: Size of the piece read at once of a client without the token: reading takes no longer, whatever was sent [B].
_PIECE_BYTES: Final = 4_096
#: Size of the end of earlier data that is searched again, for a token that arrived in two parts [B].
_OVERLAP_BYTES: Final = 256
#: Number of connections accepted before others are read from.
_ACCEPTED_AT_ONCE: Final = 64
#: Connections that may control, beside their open pages. More are answered with 503, as are all above the sum.
_MAX_CONTROLLING: Final = 128
MAX_CONNECTIONS: Final = MAX_NEW + MAX_OPEN[Right.LOOK] + MAX_VIEWERS + _MAX_CONTROLLING


class HeldFlow(FlowControl):
    """Flow control of a connection that can be held: then nothing is read, even if the server asks for more."""

    holds = False

    def resume_reading(self) -> None:
        if not self.holds:
            super().resume_reading()


class Connection(H11Protocol):
    """A connection; it is closed if its next head is late, if its client reads nothing, or if too many are open."""

    def __init__(self, limiter: ConnectionLimiter, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._limiter = limiter
        self._has_shown_token = False
        self._unread = bytearray()
        self._is_queued = False
        self._is_reading = False
        self._right_before = Right.NONE
        self._head_timer: asyncio.TimerHandle | None = None
        self._write_timer: asyncio.TimerHandle | None = None
        self.checks = 0

    def connection_made(self, transport: Any) -> None:
        self.opened_s = self.loop.time()
        super().connection_made(transport)
        self._flow = self.flow = HeldFlow(transport)
        if self.scheme == "https":
            transport.set_read_buffer_limits(MAX_HEAD_BYTES)
        self.client_name = client_network(self.client[0]) if self.client else ""
        self._await_head()
        self._limiter.schedule_check(cast("set[LimitedConnection]", self.connections))

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_waiting()
        self._unread.clear()
        self.resume_writing()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        if self._has_shown_token:
            self._read(data)
            return
        begin = max(len(self._unread) - _OVERLAP_BYTES, 0)
        self._unread += data
        if begin < MAX_HEAD_BYTES and self._limiter.shows_token(bytes(self._unread[begin:MAX_HEAD_BYTES])):
            self._has_shown_token = True
            self.read_received()
        else:
            self._queue_read()
            self._limit_unread()

    def _limit_unread(self) -> None:
        """Stop reading beyond the largest head; the rest waits in the system's buffer."""
        self._flow.holds = len(self._unread) > MAX_HEAD_BYTES
        if self._flow.holds:
            self._flow.read_paused = True
            self.transport.pause_reading()
        else:
            self._flow.resume_reading()

    def _queue_read(self) -> None:
        if not self._is_queued:
            self._is_queued = True
            self._limiter.queue_read(self)

    def read_received(self) -> None:
        """Read what has arrived so far: without the token a piece, and no more than one request."""
        self._is_queued = False
        if self.transport.is_closing() or not (self._has_shown_token or self._awaits_data):
            return
        size = len(self._unread) if self._has_shown_token else _PIECE_BYTES
        piece = bytes(self._unread[:size])
        del self._unread[:size]
        self._limit_unread()
        self._is_reading = True
        try:
            self._read(piece)
        finally:
            self._is_reading = False
        if self._unread and self._awaits_data:
            self._queue_read()

    def _read(self, data: bytes) -> None:
        answered = self.cycle
        if data:
            super().data_received(data)
        else:
            self.handle_events()
        if self.cycle is not answered and self.is_answering:
            self._stop_waiting()

    def handle_events(self) -> None:
        """Answer a request; without the token, a request that follows another is read in turn."""
        if self._is_reading or self._has_shown_token:
            super().handle_events()
        else:
            self._queue_read()

    def on_response_complete(self) -> None:
        answered = self.cycle
        self._right_before = self.right
        super().on_response_complete()
        if self.cycle is answered:  # otherwise the next request is here already
            self._await_head()

    def pause_writing(self) -> None:
        self._write_timer = self.loop.call_later(SLOW_S, self.abort)
        super().pause_writing()

    def resume_writing(self) -> None:
        if self._write_timer is not None:
            self._write_timer.cancel()
            self._write_timer = None
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

    @property
    def _awaits_data(self) -> bool:
        """Whether more can be read: after a whole request its answer comes first."""
        return not self.is_answering or self.cycle.more_body

    def abort(self) -> None:
        """Close without waiting for a client that does not read."""
        self.connections.discard(self)
        self.transport.abort()

    def _await_head(self) -> None:
        self._stop_waiting()
        self._head_timer = self.loop.call_later(HEAD_S, self.abort)

    def _stop_waiting(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None


def connection_settings(shows_token: Callable[[bytes], bool]) -> dict[str, Any]:
    """Return the settings of uvicorn that are about connections.

    Parameters
    ----------
    shows_token : function that says whether the beginning of a client's data shows the token.
    """
    return {
        "http": partial(Connection, ConnectionLimiter(shows_token)),
        "ws": "none",
        "h11_max_incomplete_event_size": MAX_HEAD_BYTES,
        "limit_concurrency": MAX_CONNECTIONS,
        "timeout_keep_alive": HEAD_S,
        "backlog": _ACCEPTED_AT_ONCE,
        "proxy_headers": False,  # a header does not decide whose connection it is
    }
