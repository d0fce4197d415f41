"""Connections that have not shown the token: they are read in turn, a few at a time, and share a few places.

A client that shows the token is read at once, and takes no place of theirs. So the work that they cause between an
emergency stop and its answer is bounded, and does not grow with their number.
"""

import asyncio
from collections import Counter, deque
from collections.abc import Callable, Iterable
from typing import Final, Protocol

from cbsr_qa.web.guard import Right
from cbsr_qa.web.line import MOST_LOOKERS

#: Number of places by right: for connections without a right, and for those that may only look.
PLACES: Final = {Right.NONE: 64, Right.LOOK: MOST_LOOKERS + 64}
#: Number of connections above which even new ones make room.
MOST_NEW: Final = 384
#: Number of connections above which they make room at once.
_CROWD: Final = 640
#: Interval between looks whether connections have to make room [s].
LOOK_S: Final = 0.25
#: Number of looks for which a connection is new and makes no room: its request may be on its way. Looks are
#: counted, not time, as a busy server looks less often.
_NEW_LOOKS: Final = 4
#: Number of connections read from before the loop serves the others again.
_READ_AT_ONCE: Final = 8


class WaitingConnection(Protocol):
    """A connection, as far as its turn and its place are concerned.

    Attributes
    ----------
    opened_s : time of its opening, by the clock of the loop [s].
    looks : number of looks since its opening.
    """

    client_name: str
    opened_s: float
    looks: int

    @property
    def right(self) -> Right: ...

    @property
    def is_answering(self) -> bool: ...

    def take_turn(self) -> None: ...

    def leave(self) -> None: ...


class Turns:
    """The turns and places of connections of one server.

    Parameters
    ----------
    shows_token : function that says whether a client's data show the token.
    """

    def __init__(self, shows_token: Callable[[bytes], bool]) -> None:
        self.shows_token = shows_token
        self._queue: deque[WaitingConnection] = deque()
        self._look: asyncio.TimerHandle | None = None
        self._soon = False

    def queue(self, connection: WaitingConnection) -> None:
        """Queue a connection, to be read from when it is its turn."""
        self._queue.append(connection)
        if len(self._queue) == 1:
            asyncio.get_running_loop().call_soon(self._give_turns)

    def _give_turns(self) -> None:
        event_loop = asyncio.get_running_loop()
        for _ in range(min(_READ_AT_ONCE, len(self._queue))):
            event_loop.call_soon(self._queue.popleft().take_turn)
        if self._queue:
            event_loop.call_soon(self._give_turns)

    def look_after(self, connections: Iterable[WaitingConnection]) -> None:
        """Schedule a look at the places after a connection was opened."""
        loop = asyncio.get_running_loop()
        open_connections = list(connections)
        if self._look is None:
            self._look = loop.call_later(LOOK_S, self._look_at, connections)
        if len(open_connections) > _CROWD and not self._soon:
            self._soon = True
            loop.call_soon(self._make_room, open_connections)

    def _look_at(self, connections: Iterable[WaitingConnection]) -> None:
        open_connections = list(connections)
        for connection in open_connections:
            connection.looks += 1
        self._make_room(open_connections)
        self._look = (
            asyncio.get_running_loop().call_later(LOOK_S, self._look_at, connections) if open_connections else None
        )

    def _make_room(self, held: Iterable[WaitingConnection]) -> None:
        """Close the oldest connections of the clients with most, until those without control fit their places."""
        self._soon = False
        for right, places in PLACES.items():
            peers = [one for one in held if one.right == right]
            if len(peers) <= places:
                continue
            by_client = Counter(one.client_name for one in peers)
            peers.sort(key=lambda one: (one.is_answering, -by_client[one.client_name], one.opened_s))
            old_peers = [one for one in peers if one.looks >= _NEW_LOOKS]
            new_peers = [one for one in peers if one.looks < _NEW_LOOKS]
            for one in [*old_peers[: len(peers) - places], *new_peers[: max(len(new_peers) - MOST_NEW, 0)]]:
                one.leave()
