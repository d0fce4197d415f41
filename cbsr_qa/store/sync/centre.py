"""The central database: whom it accepts, where its runs stand, what it refused."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Final

from sqlalchemy import (
    ColumnElement,
    Engine,
    exists,
    func,
    insert,
    select,
)

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store.chain.check import digest_documents
from cbsr_qa.store.damage import OddCellError, address, name_database
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.odd_rows import read_rows_apart
from cbsr_qa.store.schema import HEAD, Age, read_version, refusal
from cbsr_qa.store.sync.parcels import NOTHING, AlteredError, Tail
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.store.tables.runs import RunRow
from cbsr_qa.store.tables.sync import SyncAcceptsRow, SyncRefusalRow, SyncSettlementRow

_LATEST_MOMENT: Final = datetime.max.replace(tzinfo=UTC)


def check_centre(engine: Engine, station: Engine) -> None:
    """Refuse a central database that cannot take rows of this program's schema.

    Raises
    ------
    StoreError
        Naming what to upgrade first.
    """
    if engine.url == station.url:
        raise StoreError(
            f"{name_database(engine.url)} is the station's own",
            remedy="name the central database with --to or CBSR_QA_CENTRE",
        )
    version = read_version(engine)
    where, upgrade = name_database(engine.url), f"cbsr-qa db upgrade --database {address(engine.url)}"
    match version.age:
        case Age.CURRENT:
            return
        case Age.EMPTY:
            raise StoreError(
                f"{name_database(engine.url)} does not exist or is empty", remedy=f"create its tables: {upgrade}"
            )
        case Age.OLDER:
            raise StoreError(
                f"{name_database(engine.url)} has schema {version.revision}, older than the station's ({HEAD})",
                remedy=f"upgrade the central database first: {upgrade}",
            )
        case Age.NEWER:
            with reading(engine) as connection:
                oldest = connection.scalar(select(func.max(SyncAcceptsRow.oldest_schema)))
            if oldest is None or oldest > HEAD:
                whom = "states no schema of stations that it accepts"
                if oldest is not None:
                    whom = f"accepts stations of schema {oldest} or later"
                raise StoreError(
                    f"{where} {whom}; this station's is {HEAD}",
                    remedy="install the newer version of cbsr-qa on this station",
                )
        case _:
            raise refusal(engine, version)


def tails(engine: Engine, runs: Sequence[str]) -> dict[str, Tail | None]:
    """Return where runs stand at the centre: their last links; None for an unchained one.

    Unknown runs are absent, and so are those of which that cannot be read: the centre then refuses them alone.
    """
    try:
        return _read_tails(engine, runs)
    except OddCellError:
        tail_by_run: dict[str, Tail | None] = {}
        for run in runs:
            with suppress(OddCellError):
                tail_by_run |= _read_tails(engine, [run])
        return tail_by_run


def _read_tails(engine: Engine, runs: Sequence[str]) -> dict[str, Tail | None]:
    link, run = LinkRow, RunRow
    newest = select(link.run, func.max(link.number).label("number")).where(link.run.in_(runs)).group_by(link.run)
    last = newest.subquery()
    query = (
        select(run.run, run.chain, link.number, link.sha256)
        .outerjoin(last, last.c.run == run.run)
        .outerjoin(link, (link.run == run.run) & (link.number == last.c.number))
        .where(run.run.in_(runs))
    )
    with reading(engine) as connection:
        rows = connection.execute(query).all()
    return {
        row.run: None if row.chain is None else NOTHING if row.number is None else Tail(row.number, row.sha256)
        for row in rows
    }


def link_at(engine: Engine, run: str, number: int) -> str:
    """Return the digest of a link of a run; empty without one."""
    with reading(engine) as connection:
        return connection.scalar(select(LinkRow.sha256).where(LinkRow.run == run, LinkRow.number == number)) or ""


def documents_of(engine: Engine, run: str) -> dict[tuple[str, str], str]:
    """Return the digest of each document of an unchained run."""
    with reading(engine) as connection:
        return {(kind, key): content for kind, key, content in digest_documents(connection, run)}


def refuse(engine: Engine, *, kind: str, item: str, run: str | None, station: str, error: StoreError) -> None:
    """Note at the centre what was not stored; once, until it is settled."""
    digests = error.digests if isinstance(error, AlteredError) else ("", "")
    key = {"kind": kind, "item": item, "station": station, "station_sha256": digests[0], "centre_sha256": digests[1]}
    with writing(engine) as connection:
        same = [getattr(SyncRefusalRow, name) == value for name, value in key.items()]
        if connection.scalar(select(func.count()).select_from(SyncRefusalRow).where(*same, _is_open())):
            return
        row = SyncSettlementRow
        settlements = read_rows_apart(connection, row, row.kind == kind, row.item == item).rows
        settled_at = max((settlement["settled_at"] for settlement in settlements), default=None)
        values = {"run": run, "why": error.reason, "noted_at": _later_moment(settled_at)}
        connection.execute(insert(SyncRefusalRow), key | values)


@dataclass(frozen=True, slots=True)
class Refusal:
    """Something that the centre did not store; see the table ``sync_refusals``."""

    kind: str
    item: str
    station: str
    station_sha256: str
    centre_sha256: str
    run: str | None
    why: str
    noted_at: datetime


def refusals(engine: Engine) -> Sequence[Refusal]:
    """Return what was refused and is not settled, oldest first; rows that cannot be read are left out."""
    with reading(engine) as connection:
        refusal_rows = read_rows_apart(connection, SyncRefusalRow, _is_open())
    return sorted((Refusal(**row) for row in refusal_rows.rows), key=lambda refusal: (refusal.noted_at, refusal.item))


def name_unread_refusals(engine: Engine) -> tuple[str, ...]:
    """Return in words which rows of what was refused or settled cannot be read."""
    with reading(engine) as connection:
        tables = SyncRefusalRow, SyncSettlementRow
        return tuple(words for table in tables for words in read_rows_apart(connection, table).problems)


def settle(engine: Engine, kind: str, item: str) -> None:
    """Note that what was refused was accepted since, or is not to be sent."""
    row = SyncRefusalRow
    with writing(engine) as connection:
        open_ones = read_rows_apart(connection, row, row.kind == kind, row.item == item, _is_open()).rows
        if open_ones:
            latest = max(refusal["noted_at"] for refusal in open_ones)
            settled = {"kind": kind, "item": item, "settled_at": _later_moment(latest)}
            connection.execute(insert(SyncSettlementRow), settled)


def _is_open() -> ColumnElement[bool]:
    """Whether a refusal was not settled since."""
    refusal, settled = SyncRefusalRow, SyncSettlementRow
    same = settled.kind == refusal.kind, settled.item == refusal.item, settled.settled_at > refusal.noted_at
    return ~exists().where(*same, settled.settled_at <= _LATEST_MOMENT)  # a row that cannot be read settles nothing


def _later_moment(moment: datetime | None) -> datetime:
    """Return the time, or a moment that is just later than another computer's clock said."""
    now, step = datetime.now(UTC), timedelta(microseconds=1)
    return now if moment is None or not now <= moment <= _LATEST_MOMENT - step else moment + step
