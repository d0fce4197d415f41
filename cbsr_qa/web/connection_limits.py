"""Limits on connections whose clients have not shown the token: how often they are read, and how many stay open.

They are read one after the other, a few in each round of the event loop. Where too many are open, the oldest ones of
the clients with most connections are closed. A client that shows the token is read at once and counts for no limit.
So the work that the others cause between an emergency stop and its answer is bounded, and does not grow with their
number.
"""

import asyncio
from collections import Counter, deque
from collections.abc import Callable, Iterable
from typing import Final, Protocol

from cbsr_qa.web.guard import Right
from cbsr_qa.web.line import MAX_READ_ONLY_VIEWERS

#: Most connections that stay open, by right: of clients without a right, and of those that may only look.
MAX_OPEN: Final = {Right.NONE: 64, Right.LOOK: MAX_READ_ONLY_VIEWERS + 64}
#: Most new connections that stay open, beyond the limits above.
MAX_NEW: Final = 384
#: Number of connections above which they are counted at once, and not only at the next check.
_CHECK_AT_ONCE_ABOVE: Final = 640
#: Interval between checks of the number of connections [s].
CHECK_INTERVAL_S: Final = 0.25
#: Number of checks for which a connection is new and stays open: its request may be on its way. Checks are counted,
#: not time, as a busy server checks less often.
_NEW_FOR_CHECKS: Final = 4
#: Connections that are read in one round of the event loop, before it serves the others again.
_READS_PER_ROUND: Final = 8


class LimitedConnection(Protocol):
    """A connection, as far as its limits are concerned.

    Attributes
    ----------
    client_name : whose connection it is; connections of one client have the same name.
    opened_s : time of its opening, by the clock of the event loop [s].
    checks : number of checks since its opening.
    """

    client_name: str
    opened_s: float
    checks: int

    @property
    def right(self) -> Right: ...

    @property
    def is_answering(self) -> bool: ...

    def read_received(self) -> None: ...

    def abort(self) -> None: ...


class ConnectionLimiter:
    """Reads the connections of one server in turn, and closes those that are too many.

    Parameters
    ----------
    shows_token : function that says whether a client's data show the token.
    """

    def __init__(self, shows_token: Callable[[bytes], bool]) -> None:
        self.shows_token = shows_token
        self._to_read: deque[LimitedConnection] = deque()
        self._next_check: asyncio.TimerHandle | None = None
        self._checks_at_once = False

    def queue_read(self, connection: LimitedConnection) -> None:
        """Read a connection after all that wait already."""
        self._to_read.append(connection)
        if len(self._to_read) == 1:
            asyncio.get_running_loop().call_soon(self._read_some)

    def _read_some(self) -> None:
        event_loop = asyncio.get_running_loop()
        for _ in range(min(_READS_PER_ROUND, len(self._to_read))):
            event_loop.call_soon(self._to_read.popleft().read_received)
        if self._to_read:
            event_loop.call_soon(self._read_some)

    def schedule_check(self, connections: Iterable[LimitedConnection]) -> None:
        """Schedule a check of the number of connections after one was opened."""
        event_loop = asyncio.get_running_loop()
        open_connections = list(connections)
        if self._next_check is None:
            self._next_check = event_loop.call_later(CHECK_INTERVAL_S, self._check, connections)
        if len(open_connections) > _CHECK_AT_ONCE_ABOVE and not self._checks_at_once:
            self._checks_at_once = True
            event_loop.call_soon(self.close_surplus, open_connections)

    def _check(self, connections: Iterable[LimitedConnection]) -> None:
        open_connections = list(connections)
        for connection in open_connections:
            connection.checks += 1
        self.close_surplus(open_connections)
        self._next_check = (
            asyncio.get_running_loop().call_later(CHECK_INTERVAL_S, self._check, connections)
            if open_connections
            else None
        )

    def close_surplus(self, connections: Iterable[LimitedConnection]) -> None:
        """Close connections that are not allowed to control until their number is within the limits.

        Idle connections go first, then those of the clients with most connections, the oldest first.
        """
        self._checks_at_once = False
        for right, max_open in MAX_OPEN.items():
            peers = [connection for connection in connections if connection.right == right]
            if len(peers) <= max_open:
                continue
            count_by_client = Counter(peer.client_name for peer in peers)
            peers.sort(key=lambda peer: (peer.is_answering, -count_by_client[peer.client_name], peer.opened_s))
            old_peers = [peer for peer in peers if peer.checks >= _NEW_FOR_CHECKS]
            new_peers = [peer for peer in peers if peer.checks < _NEW_FOR_CHECKS]
            surplus = [*old_peers[: len(peers) - max_open], *new_peers[: max(len(new_peers) - MAX_NEW, 0)]]
            for peer in surplus:
                peer.abort()
