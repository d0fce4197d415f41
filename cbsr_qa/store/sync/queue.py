"""The queue of a station: entries of its outbox that wait, are quarantined, or were let go."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, Final

from sqlalchemy import (
    ColumnElement,
    Connection,
    Engine,
    String,
    and_,
    case,
    delete,
    false,
    func,
    null,
    or_,
    select,
    type_coerce,
    update,
)

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.odd_rows import keep_odd_text, read_rows_apart
from cbsr_qa.store.outbox import EntryState, Kind
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.store.tables.runs import RunStateRow
from cbsr_qa.store.tables.sync import OutboxRow

#: Order in which kinds are sent: what refers to runs after the runs.
_ORDER: Final = tuple(Kind)


QUARANTINED: Final = str(EntryState.QUARANTINED)


@dataclass(frozen=True, slots=True)
class Entry:
    """One announcement.

    Parameters
    ----------
    version : announced.
    sent : what the centre confirmed, of which it may have lost something since: of a chained run the number of its
        links; else 0, or more than 0 if it was confirmed as a whole and is compared again.
    noted_at : when the oldest part that was not sent was announced.
    why : why it was refused, or what it waits for.
    """

    kind: str
    item: str
    version: int
    sent: int
    noted_at: datetime
    state: str
    why: str


def waiting(engine: Engine) -> tuple[Entry, ...]:
    """Return what is to be sent, runs by age first; open runs of which the centre has all rows are left out."""
    entries, _ = _read_entries(engine, OutboxRow.state == str(EntryState.WAITING), _unsent())
    return tuple(sorted(entries, key=lambda entry: (_ORDER.index(Kind(entry.kind)), entry.item)))


@dataclass(frozen=True, slots=True)
class Backlog:
    """How much waits, and how long the oldest of it has waited [h]; None if nothing waits.

    ``unread`` counts rows of the outbox that cannot be read: nobody knows what they announce.
    """

    items: int
    age_h: float | None
    unread: int = 0

    @property
    def words(self) -> str:
        if self.unread:
            rows = "1 row" if self.unread == 1 else f"{self.unread} rows"
            return f"{self._waiting}; {rows} of outbox cannot be read, db check names them"
        return self._waiting

    @property
    def _waiting(self) -> str:
        if self.age_h is None:
            return "nothing waits"
        waits = "1 item waits" if self.items == 1 else f"{self.items} items wait"
        hours = self.age_h
        ago = f"{60 * hours:.0f} min" if hours < 2 else f"{hours:.1f} h" if hours < 48 else f"{hours / 24:.1f} days"
        return f"{waits} in this database, the oldest for {ago}"

    def late(self, limit_h: float | None) -> bool:
        return self.age_h is not None and limit_h is not None and self.age_h > limit_h


def backlog(engine: Engine) -> Backlog:
    """Return how much waits for the central database, and how long: the database counts, as 100 000 rows may wait.

    A row of unusual content, which may be one that cannot be read, is read by itself.
    """
    row, waits = OutboxRow, and_(OutboxRow.state == str(EntryState.WAITING), _unsent())
    with reading(engine) as connection, keep_odd_text(connection):
        usual = _is_usual(connection)
        counts = select(func.count(), func.count(case((waits, 1))), func.min(case((waits, row.noted_at))))
        joined = _join_text(connection)
        usual_rows, items, oldest, text = connection.execute(counts.add_columns(joined).where(usual)).one()
        rows = connection.scalar(select(func.count()).select_from(row))
    if isinstance(text, bytes):  # one of these rows holds text that is not UTF-8
        usual_rows, items, oldest, usual = 0, 0, None, false()
    moments, unread = [] if oldest is None else [oldest], 0
    if usual_rows != rows:
        others = case((usual, 0), else_=1) == 1
        entries, _ = _read_entries(engine, others, waits)
        moments += [entry.noted_at for entry in entries]
        items, unread = items + len(entries), len(_read_entries(engine, others)[1])
    age_h = max((datetime.now(UTC) - min(moments)).total_seconds() / 3600, 0.0) if moments else None
    return Backlog(items, age_h, unread)


def list_held(engine: Engine) -> tuple[Entry, ...]:
    """Return entries that are quarantined or were let go."""
    entries, _ = _read_entries(engine, OutboxRow.state != str(EntryState.WAITING))
    return entries


def name_unread(engine: Engine) -> tuple[str, ...]:
    """Return in words which rows of the outbox are passed over: with odd cells, or an unknown kind or state."""
    _, unread = _read_entries(engine)
    return unread


def confirm(engine: Engine, entry: Entry, version: int, *, more: bool) -> None:
    """Note that the centre has an entry.

    Parameters
    ----------
    version : that was sent; 0 where versions do not count parts, as links of a chained run do.
    more : whether it may grow without being announced (a run under way, or cut off): it stays in the outbox.
    """
    row = OutboxRow
    with writing(engine) as connection:
        if not more:  # announced again meanwhile, it stays
            covered = max(version, entry.version)
            connection.execute(delete(row).where(*_is(entry.kind, entry.item), row.version <= covered))
        latest = case((row.version < version, version), else_=row.version)
        values = {"sent": version, "version": latest, "noted_at": func.current_timestamp()}
        connection.execute(update(row).where(*_is(entry.kind, entry.item)).values(why="", **values))


def mark(engine: Engine, kind: str, item: str, state: EntryState, why: str) -> None:
    """Change the state of an entry."""
    with writing(engine) as connection:
        connection.execute(update(OutboxRow).where(*_is(kind, item)).values(state=str(state), why=why))


def send_again(engine: Engine, item: str) -> None:
    """Have an item wait again that was quarantined or let go; StoreError if none of that name was."""
    _decide(engine, item, EntryState.WAITING)


def let_go(engine: Engine, item: str) -> None:
    """Note that a quarantined item is not to be sent; StoreError if none of that name is held."""
    _decide(engine, item, EntryState.LET_GO)


def _decide(engine: Engine, item: str, state: EntryState) -> None:
    for entry in list_held(engine):
        if entry.item == item:
            mark(engine, entry.kind, item, state, "" if state is EntryState.WAITING else entry.why)
            return
    raise StoreError(
        f"nothing named {item[:64]!r} is quarantined or was let go", remedy="cbsr-qa db sync --status lists what is"
    )


def _unsent() -> ColumnElement[bool]:
    """Whether the centre lacks something: announced, or stored by an open chained run since."""
    row, link, state = OutboxRow, LinkRow, RunStateRow
    newest = select(func.max(link.number) + 1).where(link.run == row.item).correlate(row).scalar_subquery()
    last = select(state.end).where(state.run == row.item).order_by(state.number.desc()).limit(1).correlate(row)
    open_run = last.scalar_subquery() == str(EndReason.RUNNING)
    return or_(row.sent < row.version, case((open_run, newest), else_=0) > row.sent)


def _is_usual(connection: Connection) -> ColumnElement[bool]:
    """Whether a row is certain to be an entry, if its text is UTF-8; one that is not usual may still be one."""
    row = OutboxRow
    words = and_(row.kind.in_(list(map(str, Kind))), row.state.in_(list(map(str, EntryState))))
    if connection.dialect.name == "postgresql":  # which checks types itself
        return and_(words, row.noted_at.between(datetime(1, 1, 2, tzinfo=UTC), datetime(9999, 12, 30, tzinfo=UTC)))
    moment = type_coerce(row.noted_at, String)
    return and_(
        words,
        *(func.typeof(cell) == "text" for cell in (row.item, row.why)),
        *(func.typeof(cell) == "integer" for cell in (row.version, row.sent)),
        func.datetime(moment) == moment,
        moment >= "0001",
    )


def _join_text(connection: Connection) -> ColumnElement[Any]:
    """Select all text of the rows as one: SQLite itself does not check whether it is UTF-8."""
    if connection.dialect.name == "postgresql":
        return null()
    return func.group_concat(type_coerce(OutboxRow.item, String) + OutboxRow.why, "\n")


def _read_entries(engine: Engine, *conditions: ColumnElement[bool]) -> tuple[tuple[Entry, ...], tuple[str, ...]]:
    """Return entries, and in words the rows that are none."""
    with reading(engine) as connection:
        rows_apart = read_rows_apart(connection, OutboxRow, *conditions)
    unknown = tuple(problem for row in rows_apart.rows if (problem := _find_unknown_word(row)))
    entries = tuple(Entry(**row) for row in rows_apart.rows if not _find_unknown_word(row))
    return entries, rows_apart.problems + unknown


def _find_unknown_word(row: Mapping[str, Any]) -> str:
    """Return in words what is no kind or state of an entry; empty without one."""
    allowed: Mapping[str, type[StrEnum]] = {"kind": Kind, "state": EntryState}
    for name, words in allowed.items():
        if row[name] not in [*words]:
            key = f"kind {row['kind'][:64]}, item {row['item'][:64]}"
            return f"outbox ({key}): {name} is {row[name][:64]!r}; allowed: {', '.join(words)}"
    return ""


def _is(kind: str, item: str) -> tuple[ColumnElement[bool], ...]:
    return OutboxRow.kind == kind, OutboxRow.item == item
