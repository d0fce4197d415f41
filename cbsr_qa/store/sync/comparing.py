"""What was sent before, compared at both ends: rows with their links, and the order in which runs were begun."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from datetime import UTC, date, datetime, time
from typing import Any, Final

from sqlalchemy import Connection, Engine, func, or_, select, type_coerce
from sqlalchemy.types import NullType

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store.archives import Archives, archive_row
from cbsr_qa.store.chain.check import ALL_KINDS, check_run
from cbsr_qa.store.chain.run_documents import KEYS
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.odd_rows import keep_odd_text
from cbsr_qa.store.outbox import Kind, announce, note_confirmed
from cbsr_qa.store.runs import begun
from cbsr_qa.store.sync.parcels import NOTHING, AlteredError, newest_link, read_parcel
from cbsr_qa.store.sync.rows import counts_of
from cbsr_qa.store.tables.records import ChartReferenceRow, LinkRow, ReleaseRow, StationCheckRow
from cbsr_qa.store.tables.runs import RunRow
from cbsr_qa.store.tables.sync import OutboxRow
from cbsr_qa.store.types import first_id

#: What is announced: identifier, and when it was made.
_ITEMS: Final[Mapping[Kind, tuple[Any, Any]]] = {
    Kind.RUN: (RunRow.run, RunRow.started_at),
    Kind.STATION_CHECK: (StationCheckRow.check_id, StationCheckRow.checked_at),
    Kind.CHART_REFERENCE: (ChartReferenceRow.reference, ChartReferenceRow.made_at),
    Kind.RELEASE: (ReleaseRow.release_id, ReleaseRow.noted_at),
}
#: Identifiers asked for at once.
_IDENTIFIERS_AT_ONCE: Final = 500


def compare_run(station: Engine, centre: Engine, run: str) -> None:
    """Check that rows of a run still match their links at both ends, and at the station its frames and files.

    Whether both ends have the same links shows in the last one that both have, which the sender compares.

    Raises
    ------
    AlteredError
        Naming table and row, and the centre if it is there.
    """
    try:
        _check_station(station, run)
    except StoreError as error:
        raise AlteredError(error.reason) from error
    try:
        with reading(centre) as connection:
            check_run(connection, run, ALL_KINDS)  # the station need not reach the centre's archives
    except StoreError as error:
        raise AlteredError(f"at the centre, {error.reason}") from error


def _check_station(station: Engine, run: str) -> None:
    """Check a run as it is checked when it is sent, a fifth of the time of reading it as a whole."""
    tail, linked, archives = NOTHING, Counter[str](), Archives()
    with reading(station) as connection:
        if archive_row(connection, run) is None:
            while tail != newest_link(connection, run):
                parcel = read_parcel(connection, run, tail, archives)
                linked.update({name: len(rows) for name, rows in parcel.rows.items()})
                tail = parcel.tail
            stored = counts_of(connection, run, [*KEYS, LinkRow.__tablename__])
            if all(linked[name] == count for name, count in stored.items()):
                return
        check_run(connection, run, ALL_KINDS)  # names the row that no link covers


def announce_since(station: Engine, day: date) -> None:
    """Announce everything from a day on (UTC), so that it is compared with the centre's, and sent if need be.

    What nothing waited of was confirmed by the centre: its entry says so in ``sent``, so that a loss is noticed.
    """
    since = datetime.combine(day, time(), UTC)
    for kind, (name, made_at) in _ITEMS.items():
        with reading(station) as connection:
            stored: Any = select(type_coerce(name, NullType())).where(made_at >= since).order_by(name)
            with keep_odd_text(connection):
                items = [item for item in connection.scalars(stored) if isinstance(item, str)]
        with writing(station) as connection:
            confirmed = _drop_announced(connection, kind, items)
            link_counts: dict[str, int] = {}
            if kind is Kind.RUN and confirmed:
                query = select(LinkRow.run, func.max(LinkRow.number) + 1).group_by(LinkRow.run)
                link_counts = {row[0]: row[1] for row in connection.execute(query)}
            note_confirmed(connection, kind, {item: link_counts.get(item, 1) for item in confirmed})


def announce_missing(station: Engine) -> Mapping[str, begun.Gap]:
    """Return the runs that are missing in a station's database, and have them in its outbox: its operator decides."""
    with reading(station) as connection:
        missing = {gap.run: gap for gap in begun.gaps(connection) if not gap.refused}
    if missing:
        with writing(station) as connection:
            announce(connection, Kind.RUN, _drop_announced(connection, Kind.RUN, missing))
    return missing


def _drop_announced(connection: Connection, kind: Kind, items: Iterable[str]) -> list[str]:
    stored: Any = select(type_coerce(OutboxRow.item, NullType())).where(OutboxRow.kind == str(kind))
    with keep_odd_text(connection):
        announced_items = set(connection.scalars(stored))
    return [item for item in items if item not in announced_items]


def list_runs_only_at_centre(station: Engine, centre: Engine, day: date) -> tuple[str, ...]:
    """Return runs from a day on (UTC) that the centre has of the stations of a database, and that are not in it.

    A station is one by its name in runs: whoever may add rows at the centre can add a run in the name of any.
    """
    since = datetime.combine(day, time(), UTC)
    run: Any = type_coerce(RunRow.run, NullType())
    stated: Any = type_coerce(RunRow.station, NullType())
    with reading(station) as connection, keep_odd_text(connection):
        ours = set(connection.scalars(select(run)))
        names = [name for name in connection.scalars(select(stated).distinct()) if isinstance(name, str)]
    later = or_(RunRow.started_at >= since, RunRow.run >= first_id(since))
    theirs = select(run).where(RunRow.station.in_(names), later).order_by(RunRow.run)
    with reading(centre) as connection, keep_odd_text(connection):
        return tuple(name for name in connection.scalars(theirs) if isinstance(name, str) and name not in ours)


def name_other_runs(station: Engine, centre: Engine, runs: Collection[str]) -> tuple[str, ...]:
    """Return in words which runs the centre has that follow those of a station's database, and are not in it.

    Parameters
    ----------
    runs : that were sent now; the latest run of the database is looked at too.
    """
    with reading(station) as ours, reading(centre) as theirs:
        before = set(
            ours.scalars(select(RunRow.before_run).where(RunRow.run.in_(list(runs)[-_IDENTIFIERS_AT_ONCE:])))
        )
        before |= {begun.latest_begun(ours)}
        followers = select(RunRow.run, RunRow.before_run).where(RunRow.before_run.in_(before - {None}))
        follower_rows = theirs.execute(followers.order_by(RunRow.run)).all()
        here = set(ours.scalars(select(RunRow.run).where(RunRow.run.in_([row.run for row in follower_rows]))))
    return tuple(
        f"the centre has run {begun.name_run(row.run)}, which follows run {row.before_run} and is not in this"
        " database: it was removed here, or this is a copy or an older state of the database that it was begun in"
        for row in follower_rows
        if row.run not in here
    )
