"""The outbox: what a central database has not confirmed yet, announced in the transaction that stores it."""

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Final

from sqlalchemy import Connection, text


class Kind(StrEnum):
    """Kind of an announced item."""

    RUN = "run"
    STATION_CHECK = "station check"
    CHART_REFERENCE = "chart reference"
    RELEASE = "release"


class EntryState(StrEnum):
    """State of an announcement."""

    WAITING = "waiting"
    QUARANTINED = "quarantined"  #: it was refused, and is not sent until somebody says so
    LET_GO = "let go"  #: somebody decided that it is not sent


# Built once, and in plain words: SQLAlchemy has no ON CONFLICT that is alike for both databases.
_ANNOUNCE: Final = text(
    "INSERT INTO outbox (kind, item, version, sent, noted_at, state, why)"
    " VALUES (:kind, :item, :version, 0, CURRENT_TIMESTAMP, 'waiting', '')"
    " ON CONFLICT (kind, item) DO UPDATE SET"
    " version = CASE WHEN excluded.version > outbox.version THEN excluded.version ELSE outbox.version + 1 END,"
    " noted_at = CASE WHEN outbox.sent < outbox.version THEN outbox.noted_at ELSE excluded.noted_at END"
)
#: Insertion of an item to look at again: it waits, and ``sent`` says what the centre confirmed.
_CONFIRMED: Final = text(
    "INSERT INTO outbox (kind, item, version, sent, noted_at, state, why)"
    " VALUES (:kind, :item, :sent + 1, :sent, CURRENT_TIMESTAMP, 'waiting', '')"
)


def announce(connection: Connection, kind: Kind, items: Iterable[str], version: int = 1) -> None:
    """Note that something was stored; a later version of the same item replaces the note."""
    rows = [{"kind": str(kind), "item": item, "version": version} for item in items]
    if rows:
        connection.execute(_ANNOUNCE, rows)


def note_confirmed(connection: Connection, kind: Kind, confirmed: Mapping[str, int]) -> None:
    """Queue items that the centre has confirmed, to be compared with its content; they must not be queued yet.

    Parameters
    ----------
    confirmed : item → links of a chained run; 1 for anything else.
    """
    rows = [{"kind": str(kind), "item": item, "sent": sent} for item, sent in confirmed.items()]
    if rows:
        connection.execute(_CONFIRMED, rows)
