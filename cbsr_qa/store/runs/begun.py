"""The order in which runs were begun in a database: each names the one before it, so that a missing one is noticed.

The row of a run, which its first link covers, holds the digest of the last link that the run before it had by then.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import BigInteger, Connection, and_, cast, exists, func, insert, or_, select, type_coerce
from sqlalchemy.orm import aliased
from sqlalchemy.types import NullType

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store.chain.links import chain_head, take_turns
from cbsr_qa.store.odd_rows import keep_odd_text
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.store.tables.runs import RunBegunRow, RunRow
from cbsr_qa.store.tables.sync import SyncRefusalRow
from cbsr_qa.store.types import time_of_id

#: Numbers as they are stored: the column may hold larger ones than the program writes.
_NUMBER: Final[Any] = type_coerce(RunBegunRow.number, NullType())
#: By how much numbers may exceed the number of rows: rows are removed by hand only.
_MAX_SPARE_NUMBERS: Final = 1_000_000
_DIGEST_BYTES: Final = 32


@dataclass(frozen=True, slots=True)
class _Begun:
    """A run that was begun, and the digest of its first link."""

    run: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Gap:
    """A run that was begun in a database and is not there as it was begun.

    Parameters
    ----------
    run : which is missing, or has another first link.
    after, station : the run that was begun after it, and where; empty where none was.
    words : what is wrong.
    refused : whether this database refused the run when it was sent here.
    """

    run: str
    words: str
    after: str = ""
    station: str = ""
    refused: bool = False


def run_before(connection: Connection) -> dict[str, Any]:
    """Return the columns of a new run that say which was begun before it in this database, and how far that had come.

    Whoever begins another one waits until this transaction ends. The first that is begun here follows the latest that
    was sent here.
    """
    take_turns(connection, "runs begun")
    newest = _newest(connection)
    before = connection.scalar(select(func.max(RunRow.run))) if newest is None else newest.run
    number, sha256 = (None, None) if newest is None else (0, newest.sha256)
    links = select(LinkRow.number, LinkRow.sha256).where(LinkRow.run == before).order_by(LinkRow.number.desc())
    if (last := connection.execute(links.limit(1)).one_or_none()) is not None:
        number, sha256 = last.number, last.sha256
    return {"before_run": before, "before_link": number, "before_sha256": sha256}


def latest_begun(connection: Connection) -> str | None:
    """Return the run that was begun last in this database; None where none was."""
    newest = _newest(connection)
    return None if newest is None else newest.run


def check_begun_here(connection: Connection, run: str) -> None:
    """Check that a run was begun in this database. StoreError names the station of one that was sent here."""
    if connection.scalar(select(RunBegunRow.number).where(RunBegunRow.run == run)) is None:
        station = connection.scalar(select(RunRow.station).where(RunRow.run == run))
        raise StoreError(
            f"run {run} was begun in another database, of station {station!r}, and sent here",
            remedy="issue and revoke its certificates in that one; db sync sends them here",
        )


def note_begun(connection: Connection, run: str) -> None:
    """Note that a run was begun in this database, once its first link is stored."""
    row = {"number": _free_number(connection), "run": run, "sha256": chain_head(connection, run)}
    connection.execute(insert(RunBegunRow), row)


def _free_number(connection: Connection) -> int:
    """Return the first free number after the largest that a run can have, whether that row can be read or not."""
    largest = select(func.max(_NUMBER)).where(_limit(connection) > _NUMBER)
    last = connection.scalar(largest)
    if last is None:
        return 0
    following, next_number = aliased(RunBegunRow), cast(_NUMBER, BigInteger) + 1
    next_is_taken = exists().where(type_coerce(following.number, NullType()) == next_number)
    free = select(func.min(next_number)).where(last <= _NUMBER, ~next_is_taken)
    return int(connection.execute(free).scalar_one())


def _newest(connection: Connection) -> _Begun | None:
    """Return the run that was begun last; passes over rows with an odd cell, or a number that no run can have."""
    plain: list[Any] = [type_coerce(cell, NullType()) for cell in (RunBegunRow.run, RunBegunRow.sha256)]
    stored: Any = select(_NUMBER, *plain)
    newest = stored.where(_limit(connection) > _NUMBER).order_by(_NUMBER.desc())
    with keep_odd_text(connection), connection.execute(newest.execution_options(yield_per=10)) as rows:
        for _, run, sha256 in rows:
            if isinstance(run, str) and isinstance(sha256, bytes) and len(sha256) == _DIGEST_BYTES:
                return _Begun(run, sha256.hex())
    return None


def _limit(connection: Connection) -> int:
    """Return a number that no run has: somebody who may add rows can take the largest that the column holds."""
    return (connection.scalar(select(func.count()).select_from(RunBegunRow)) or 0) + _MAX_SPARE_NUMBERS


def name_odd_rows(connection: Connection) -> tuple[str, ...]:
    """Return in words which rows of ``runs_begun`` have a number that no run can have."""
    limit = _limit(connection)
    numbers = connection.scalars(select(_NUMBER).where(limit <= _NUMBER).order_by(_NUMBER))
    return tuple(f"runs_begun (number {number}) has a number that no run here can have" for number in numbers)


def gaps(connection: Connection) -> tuple[Gap, ...]:
    """Return the runs that others name as begun before them, or that were begun here, and that are missing."""
    named = {gap.run: gap for gap in _gaps_between_runs(connection)}
    return (*named.values(), *(gap for gap in _gaps_in_list(connection) if gap.run not in named))


def _gaps_between_runs(connection: Connection) -> Iterator[Gap]:
    before, link, refusal = aliased(RunRow), LinkRow, SyncRefusalRow
    refused = exists().where(refusal.item == RunRow.before_run).label("refused")
    query = (
        select(RunRow.run, RunRow.station, RunRow.started_at, RunRow.before_run, before.run.label("present"), refused)
        .outerjoin(before, before.run == RunRow.before_run)
        .outerjoin(link, and_(link.run == RunRow.before_run, link.number == RunRow.before_link))
        .where(RunRow.before_run.is_not(None))
        .where(or_(before.run.is_(None), func.coalesce(link.sha256 != RunRow.before_sha256, link.sha256.is_(None))))
        .where(or_(before.run.is_(None), RunRow.before_sha256.is_not(None)))
    )
    for row in connection.execute(query.order_by(RunRow.run)):
        after = f"the run before {row.run} (begun {row.started_at:%Y-%m-%d %H:%M} UTC)"
        words = f"{after} is missing: run {name_run(row.before_run)}"
        if row.present is not None:
            words = f"{after} was another one, or had more rows, than run {row.before_run} that is there"
        yield Gap(row.before_run, words, row.run, row.station, bool(row.refused))


def _gaps_in_list(connection: Connection) -> Iterator[Gap]:
    begun_row, link = RunBegunRow, LinkRow
    named: Any = type_coerce(begun_row.run, NullType()).label("run")
    query = (
        select(named, type_coerce(RunRow.run, NullType()).label("present"))
        .outerjoin(RunRow, RunRow.run == begun_row.run)
        .outerjoin(link, and_(link.run == begun_row.run, link.number == 0))
        .where(func.coalesce(link.sha256 != begun_row.sha256, link.sha256.is_(None)))
    )
    with keep_odd_text(connection):
        rows = connection.execute(query.order_by(begun_row.number)).all()
    for row in rows:
        if not isinstance(row.run, str):  # named by find_odd_rows
            continue
        what = "is missing" if row.present is None else "is another one by now"
        yield Gap(row.run, f"run {name_run(row.run)} {what}: it was begun in this database")


def forks(connection: Connection) -> tuple[str, ...]:
    """Return in words where several runs name the same one before them: a copy of a database was worked with."""
    several = select(RunRow.before_run).group_by(RunRow.before_run).having(func.count() > 1)
    query = select(RunRow.before_run, RunRow.run).where(RunRow.before_run.in_(several))
    following: dict[str | None, list[str]] = {}
    for before, run in connection.execute(query.order_by(RunRow.before_run, RunRow.run)):
        following.setdefault(before, []).append(run)
    return tuple(
        f"runs {' and '.join(runs)} follow the same run {before}: their database was copied, or restored from a copy,"
        " and worked with"
        for before, runs in following.items()
    )


def name_run(run: str) -> str:
    """Name a run by its identifier and when it was made."""
    made = time_of_id(run)
    return run if made is None else f"{run} (begun {made:%Y-%m-%d %H:%M} UTC)"
