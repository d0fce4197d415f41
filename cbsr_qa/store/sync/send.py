"""One pass over the outbox: everything that waits is sent, in an order in which references hold."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import date
from typing import Final

from sqlalchemy import Engine, select

from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.archives import Archives
from cbsr_qa.store.damage import OddCellError
from cbsr_qa.store.engine import reading
from cbsr_qa.store.locks import sending_alone
from cbsr_qa.store.outbox import EntryState, Kind
from cbsr_qa.store.runs import begun
from cbsr_qa.store.runs.rows import current_state
from cbsr_qa.store.sync.centre import (
    check_centre,
    documents_of,
    link_at,
    name_unread_refusals,
    refusals,
    refuse,
    settle,
    tails,
)
from cbsr_qa.store.sync.comparing import (
    announce_missing,
    announce_since,
    compare_run,
    list_runs_only_at_centre,
    name_other_runs,
)
from cbsr_qa.store.sync.items import read_item
from cbsr_qa.store.sync.parcels import NOTHING, AlteredError, Parcel, Tail, newest_link, read_parcel, read_unchained
from cbsr_qa.store.sync.queue import Entry, confirm, list_held, mark, name_unread, waiting
from cbsr_qa.store.sync.storing import RowRefusedError, WaitsError, store_item, store_parcel
from cbsr_qa.store.tables.runs import RunRow

#: Number of entries for whose runs the centre's states are read at once.
_BATCH_SIZE: Final = 64
#: End of every sentence that says that the centre lost something.
_SENT_AGAIN: Final = ": it lost that, or is another database than the one that confirmed it; it was sent again"
#: Number of tries to send a run, of which another process may send rows meanwhile.
_MAX_TRIES: Final = 3


@dataclass(frozen=True, slots=True)
class Lost:
    """Something that the centre had confirmed and later lacked, wholly or in part."""

    kind: str
    item: str
    why: str


@dataclass(frozen=True, slots=True)
class Added:
    """A run of which the centre has rows, or everything, that this database does not have."""

    run: str
    why: str


@dataclass(slots=True)
class Sent:
    """What one pass did.

    Parameters
    ----------
    items : entries of which the centre took rows, ``runs`` of them runs; new and further rows alike.
    compared : runs of which the centre had rows: those were compared at both ends.
    rows, size : number of rows, and bytes of arrays and files, stored at the centre.
    quarantined : entries that were refused.
    blocked : entries that wait until what they refer to is at the centre.
    notes : runs that the centre has more than this database, in words.
    lost : what the centre had lost, and has again.
    added : runs of which the centre has rows that this database does not have, or that are there alone.
    unread : rows of the outbox, and of what the centre refused, that cannot be read, in words; they are passed over.
    """

    items: int = 0
    runs: int = 0
    compared: int = 0
    rows: int = 0
    size: int = 0
    quarantined: list[Entry] = field(default_factory=list)
    blocked: list[Entry] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    lost: list[Lost] = field(default_factory=list)
    added: list[Added] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)


def send_waiting(
    station: Engine,
    centre: Engine,
    who: str,
    progress: Callable[[int, int, Sent], None] | None = None,
    *,
    compare_since: date | None = None,
) -> Sent:
    """Send everything that waits in a station's outbox to a central database.

    Parameters
    ----------
    who : names this process to others that want to send from the same database, and the sender at the centre.
    progress : called after each entry with the number of entries done, of all entries, and the totals so far.
    compare_since : compare everything from this day on (UTC) with the centre's, also what was sent long ago.

    Raises
    ------
    StoreError
        If another process sends from this database, or the centre cannot be used; what is confirmed until then is
        sent, the rest still waits.
    """
    sent = Sent()
    with sending_alone(station, who):
        check_centre(centre, station)
        if compare_since is not None:
            announce_since(station, compare_since)
        missing = announce_missing(station)
        entries = waiting(station)
        sent.unread += name_unread(station)
        sent.unread += (f"at the centre, {words}" for words in name_unread_refusals(centre))
        refused = {(refusal.kind, refusal.item) for refusal in refusals(centre)}
        for entry in list_held(station):
            if entry.state == EntryState.LET_GO and (entry.kind, entry.item) in refused:
                settle(centre, entry.kind, entry.item)
        for first in range(0, len(entries), _BATCH_SIZE):
            batch = entries[first : first + _BATCH_SIZE]
            central_tails = tails(centre, [entry.item for entry in batch if entry.kind == Kind.RUN])
            for done, entry in enumerate(batch, start=first + 1):
                stored = _send(station, centre, entry, central_tails, missing, sent)
                if stored and (entry.kind, entry.item) in refused:
                    settle(centre, entry.kind, entry.item)
                if progress is not None:
                    progress(done, len(entries), sent)
        if compare_since is not None:
            sent.added += map(_name_added_run, list_runs_only_at_centre(station, centre, compare_since))
        runs = [entry.item for entry in entries if entry.kind == Kind.RUN]
        sent.notes += name_other_runs(station, centre, runs)
    return sent


def _name_added_run(run: str) -> Added:
    why = (
        f"the centre has run {begun.name_run(run)} in the name of a station of this database, which does not have it:"
        " it was added there, removed here, or measured into another database"
    )
    return Added(run, why)


def _send(
    station: Engine,
    centre: Engine,
    entry: Entry,
    central_tails: Mapping[str, Tail | None],
    missing: Mapping[str, begun.Gap],
    sent: Sent,
) -> bool:
    """Send one entry; return whether the centre has it now."""
    gap = missing.get(entry.item) if entry.kind == Kind.RUN else None
    tail, rows_before = central_tails.get(entry.item, NOTHING), sent.rows
    try:
        if gap is not None:
            raise AlteredError(gap.words)
        if entry.kind == Kind.RUN:
            _send_run(station, centre, entry, tail, sent)
        else:
            _send_item(station, centre, entry, sent)
    except WaitsError as error:
        mark(station, entry.kind, entry.item, EntryState.WAITING, error.reason)
        sent.blocked.append(entry)
        if entry.kind == Kind.RUN:  # runs that were begun after it are sent
            run, station_name = _find_origin(station, entry)
            refuse(centre, kind=entry.kind, item=entry.item, run=run, station=station_name, error=error)
    except (AlteredError, RowRefusedError, OddCellError) as error:
        run, station_name = (gap.run, gap.station) if gap is not None else _find_origin(station, entry)
        refuse(centre, kind=entry.kind, item=entry.item, run=run, station=station_name, error=error)
        mark(station, entry.kind, entry.item, EntryState.QUARANTINED, error.reason)
        sent.quarantined.append(entry)
    else:
        if sent.rows > rows_before and (why := _describe_loss(entry, tail)):
            sent.lost.append(Lost(entry.kind, entry.item, why))
        return True
    return False


def _describe_loss(entry: Entry, tail: Tail | None) -> str:
    """Return what the centre lacked of an entry that it had confirmed, in words; empty if that was nothing.

    Parameters
    ----------
    tail : last link of a run at the centre before more of it was sent.
    """
    if not entry.sent:
        return ""
    if entry.kind != Kind.RUN or tail == NOTHING:
        return f"the centre had confirmed it and did not have it{_SENT_AGAIN}"
    if tail is None:  # without a chain: nothing counts its parts
        return f"the centre had confirmed it and lacked rows of it{_SENT_AGAIN}"
    had = tail.number + 1
    return (
        "" if had >= entry.sent else f"the centre had confirmed {entry.sent} links of it and had {had}{_SENT_AGAIN}"
    )


def _send_run(station: Engine, centre: Engine, entry: Entry, tail: Tail | None, sent: Sent) -> None:
    """Send what the centre lacks of a run; again from its new state there if somebody else sent rows meanwhile."""
    rows_before = sent.rows
    for tries_left in reversed(range(_MAX_TRIES)):
        try:
            _send_missing_rows(station, centre, entry, tail, sent)
            new = sent.rows > rows_before
            sent.items, sent.runs = sent.items + new, sent.runs + new
            return
        except (AlteredError, RowRefusedError):
            tail_now = tails(centre, [entry.item]).get(entry.item, NOTHING)
            if not tries_left or tail_now == tail:
                raise
            tail = tail_now


def _send_missing_rows(station: Engine, centre: Engine, entry: Entry, tail: Tail | None, sent: Sent) -> None:
    """Send the rows of a run that follow the centre's tail, and compare those before it if the run has ended.

    AlteredError if the run is not in this database, or differs from what the centre has.
    """
    run = entry.item
    with reading(station) as connection:
        row = connection.execute(select(RunRow.chain).where(RunRow.run == run)).one_or_none()
        newest = newest_link(connection, run)
        ended = row is not None and current_state(connection, run).end != EndReason.RUNNING
    if row is None:
        raise AlteredError(f"run {run} is announced, and not in the database")
    if row.chain is None:
        _send_unchained(station, centre, entry, known=tail != NOTHING, sent=sent)
        return
    if tail is None:
        raise AlteredError(f"run {run} has a chain here and none at the centre")
    if tail.number > newest.number:  # this database is an older copy of the one that sent the run
        if (stored := link_at(centre, run, newest.number)) != newest.sha256:
            raise AlteredError(f"link {newest.number} of run {run} differs from the centre's", newest.sha256, stored)
        compare_run(station, centre, run)
        sent.compared += 1
        confirm(station, entry, newest.number + 1, more=False)
        why = (
            f"the centre has {tail.number - newest.number} links more of run {run}: rows were added there, or this"
            " database is an older copy of the one that sent them"
        )
        sent.added.append(Added(run, why))
        return
    if tail != NOTHING and ended:
        compare_run(station, centre, run)
        sent.compared += 1
    archives = Archives()
    while True:
        with reading(station) as connection:
            parcel = read_parcel(connection, run, tail, archives)
        if parcel.rows:
            _store(centre, parcel, sent)
            tail = parcel.tail
        if parcel.whole:
            break
    confirm(station, entry, parcel.version, more=parcel.open)


def _send_unchained(station: Engine, centre: Engine, entry: Entry, *, known: bool, sent: Sent) -> None:
    """Send a run without a chain: its whole content is compared with what the centre has."""
    stored = documents_of(centre, entry.item) if known else {}
    with reading(station) as connection:
        parcel = read_unchained(connection, entry.item, stored)
    if parcel.rows:
        _store(centre, parcel, sent)
    confirm(station, entry, 0, more=False)


def _store(centre: Engine, parcel: Parcel, sent: Sent) -> None:
    store_parcel(centre, parcel)
    sent.rows += parcel.row_count
    sent.size += parcel.size


def _send_item(station: Engine, centre: Engine, entry: Entry, sent: Sent) -> None:
    kind = Kind(entry.kind)
    with reading(station) as connection:
        item = read_item(connection, kind, entry.item)
    if item is None:
        raise AlteredError(f"{entry.kind} {entry.item} is announced, and not in the database")
    new = store_item(centre, kind, entry.item, item)
    confirm(station, entry, 0, more=False)
    sent.items += new
    sent.rows += sum(map(len, item.rows.values())) if new else 0


def _find_origin(station: Engine, entry: Entry) -> tuple[str | None, str]:
    """Return the run and the name of the station of a refused entry; the name is empty if it cannot be read."""
    run = entry.item if entry.kind == Kind.RUN else None
    with suppress(OddCellError), reading(station) as connection:
        if run is not None:
            return run, connection.scalar(select(RunRow.station).where(RunRow.run == run)) or ""
        item = read_item(connection, Kind(entry.kind), entry.item)
        return None, "" if item is None else item.station
    return run, ""
