"""Connections to the server: every head of a request is timed, and who has not shown the token waits for a turn.

Who shows the token is read at once and takes no place of a stranger (:mod:`cbsr_qa.web.strangers`), so that an
emergency stop is answered before what strangers ask. How soon that is under load is measured by
``benchmarks/emergency_stops.py``; see ``docs/how-to/run-a-line.md``.
"""

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final, cast

from uvicorn.protocols.http.h11_impl import H11Protocol

from cbsr_qa.web.guard import Right
from cbsr_qa.web.guesses import client_network
from cbsr_qa.web.line import MOST_VIEWERS
from cbsr_qa.web.strangers import MOST_NEW, PLACES, Stranger, Strangers

#: How long the head of a request may take, from the opening of its connection or the answer before it [s].
HEAD_S: Final = 10.0
#: A client that takes nothing of what it is sent for so long is left [s].
SLOW_S: Final = 30.0
#: Largest head of a request [B].
MOST_HEAD: Final = 16_384
#: What a stranger sends before its turn; more is not taken from the system until then [B].
_MOST_UNREAD: Final = 4 * MOST_HEAD
#: Connections that are accepted before others are read from.
_ACCEPTED_AT_ONCE: Final = 64
#: Connections that may control, beside their open pages. More are answered with 503, as are all above the sum.
_MOST_CONTROL: Final = 128
MOST_CONNECTIONS: Final = MOST_NEW + PLACES[Right.LOOK] + MOST_VIEWERS + _MOST_CONTROL


class Connection(H11Protocol):
    """A connection that is closed if its next head is late, if it is not read from, or if others need its place."""

    def __init__(self, strangers: Strangers, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._strangers = strangers
        self._has_shown_token = False
        self._unread = bytearray()
        self._right_before = Right.NONE
        self._late: asyncio.TimerHandle | None = None
        self._slow: asyncio.TimerHandle | None = None
        self.looks = 0

    def connection_made(self, transport: Any) -> None:
        self.opened_s = self.loop.time()
        super().connection_made(transport)
        self.client_name = client_network(self.client[0]) if self.client else ""
        self._await_head()
        self._strangers.look_after(cast("set[Stranger]", self.connections))

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_waiting()
        self._unread.clear()
        self.resume_writing()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        if self._has_shown_token:
            self._read(data)
            return
        waits = bool(self._unread)
        self._unread += data
        if self._strangers.shows_token(bytes(self._unread)):
            self._has_shown_token = True
            self.take_turn()
        elif not waits:
            self._strangers.queue(self)
        elif len(self._unread) > _MOST_UNREAD:
            self.flow.pause_reading()

    def take_turn(self) -> None:
        """Read what has arrived so far."""
        if not self._unread or self.transport.is_closing():
            return
        data = bytes(self._unread)
        self._unread.clear()
        self.flow.resume_reading()
        self._read(data)

    def _read(self, data: bytes) -> None:
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
        self._slow = self.loop.call_later(SLOW_S, self.leave)
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

    def leave(self) -> None:
        """Close without waiting for a client that does not read."""
        self.connections.discard(self)
        self.transport.abort()

    def _await_head(self) -> None:
        self._stop_waiting()
        self._late = self.loop.call_later(HEAD_S, self.leave)

    def _stop_waiting(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None


def connection_settings(shows_token: Callable[[bytes], bool]) -> dict[str, Any]:
    """Return the settings of uvicorn that are about connections.

    Parameters
    ----------
    shows_token : whether the beginning of what a client sent shows that it has the token.
    """
    return {
        "http": partial(Connection, Strangers(shows_token)),
        "ws": "none",
        "h11_max_incomplete_event_size": MOST_HEAD,
        "limit_concurrency": MOST_CONNECTIONS,
        "timeout_keep_alive": HEAD_S,
        "backlog": _ACCEPTED_AT_ONCE,
        "proxy_headers": False,  # a header does not decide whose connection it is
    }
