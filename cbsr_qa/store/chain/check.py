"""Verification of a stored run: every row that is read must match its digest."""

import hashlib
from collections.abc import Collection, Iterator, Sequence
from typing import Any, Final

from sqlalchemy import (
    Boolean,
    ColumnElement,
    Connection,
    Integer,
    Row,
    Table,
    and_,
    func,
    select,
    type_coerce,
)
from sqlalchemy.orm import aliased

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.run.run import ChainState
from cbsr_qa.store.archives import read_checked
from cbsr_qa.store.chain.links import (
    SigningKey,
    chain_head,
    checking_key,
    key_id_of,
    link_digest,
    match_few_links,
)
from cbsr_qa.store.chain.run_documents import (
    FIGURES,
    KEYS,
    documents,
    figures_digest,
    list_covered,
    name_document,
    sha256,
    tables,
)
from cbsr_qa.store.damage import FOREIGN_CELL, find_foreign_cell
from cbsr_qa.store.tables.records import MANY_LINKS, LinkRow
from cbsr_qa.store.tables.results import AnalysisRow, CalibrationRow
from cbsr_qa.store.tables.runs import Base, RunRow, RunStateRow

#: Columns read of a run to judge its outcome and to identify it.
RESULTS: Final = frozenset(
    {"runs", FIGURES, *(name for name, key in KEYS.items() if key in (("analysis",), ("calibration",)))}
)
IDENTITY: Final = frozenset({"runs", "instruments", "run_parts"})
ALL_KINDS: Final = frozenset({*KEYS, FIGURES})
#: Documents that state what followed from the data of a run, or what people decided.
_CONCLUDED: Final = RESULTS - {"runs"} | {
    "verdict_overrides",
    "reanalyses",
    "certificates",
    "certificate_withdrawals",
}
#: Names from which on PostgreSQL is asked for a range of them, where that is possible.
_MIN_RANGE: Final = 20
#: Remedy for a run that was altered.
RESTORE: Final = "restore the database from a copy; this run is not evaluated as it is"


def check_run(connection: Connection, run: str, kinds: Collection[str] = ()) -> ChainState:
    """Check a stored run: its configuration, the links of its chain, and the rows under it.

    Frames and samples are checked against the digests in their rows where they are read (see runs/codec.py).

    Parameters
    ----------
    kinds : of the documents to check, empty for all, with the chain from end to end.

    Returns
    -------
    State of the chain; unchained where the run has none, which may have been removed.

    Raises
    ------
    StoreError
        If the run does not exist, or a row was altered: the message names table and row.
    """
    try:
        return _check_chain(connection, run, kinds)
    except FOREIGN_CELL as error:
        raise unreadable(connection, run, error) from error


def check_unless_checked(connection: Connection, run: str, checked_link: str, kinds: Collection[str] = ()) -> None:
    """Check a run as :func:`check_run`, unless it was checked up to its last link.

    Parameters
    ----------
    checked_link : digest of the last link that was checked, as when the run was loaded (``chain_head``); empty: none.
    """
    if not checked_link or chain_head(connection, run) != checked_link:
        check_run(connection, run, kinds)


def data_digest(connection: Connection, run: str) -> str:
    """Return the digest of everything that was measured in a run: the chain up to the last link of its data.

    Without a chain, the digest of the rows, which hold the digests of frames and samples.
    """
    link = LinkRow
    of_data = select(link.sha256).where(link.run == run, link.kind.not_in(_CONCLUDED))
    head = connection.scalar(of_data.order_by(link.number.desc()).limit(1))
    return head or sha256(*map("/".join, digest_documents(connection, run, ALL_KINDS - _CONCLUDED)))


def unreadable(connection: Connection, run: str, error: Exception) -> StoreError:
    """Return the error for a run that cannot be read: the cell of the wrong type if there is one, else the cause."""
    rows = [(table, select_run(table, run)) for table in (*tables(), Base.metadata.tables[LinkRow.__tablename__])]
    return find_foreign_cell(connection, rows, f"run {run}") or _broken(
        run, f"it cannot be read: {type(error).__name__}: {str(error).partition(chr(10))[0]}"
    )


def _check_chain(connection: Connection, run: str, kinds: Collection[str]) -> ChainState:
    row = connection.execute(
        select(RunRow.chain, RunRow.configuration, RunRow.configuration_digest).where(RunRow.run == run)
    ).one_or_none()
    if row is None:
        raise StoreError(f"no run {run[:64]!r} in this database")
    if hashlib.sha256(row.configuration.encode()).hexdigest() != row.configuration_digest:
        raise _broken(run, "its configuration is not the one it was begun with: the digest in its row does not match")
    links = _links(connection, run, kinds)
    if row.chain is None:
        if links:
            raise _broken(run, "its row in runs states no chain, and run_links holds links of it")
        _check_never_chained(connection, run)
        return ChainState()
    if not links:
        raise _broken(run, "it is chained, and run_links holds no link of it")
    key_id, key = key_id_of(row.chain), checking_key(connection, row.chain)
    if not kinds and (missing := set(range(links[-1].number)) - {link.number for link in links}):
        raise _broken(run, f"link {min(missing)} in run_links is missing")
    for link in links:
        _check_link(run, link, key_id, key)
    if not kinds:
        read_checked(connection, run)
    _check_rows(
        connection, run, kinds or ALL_KINDS, {(link.kind, link.document): link.content_sha256 for link in links}
    )
    if AnalysisRow.__tablename__ in kinds and runs_with_a_gap(connection, [run]):
        return _check_chain(connection, run, ())  # names the link
    return chain_state(connection, row.chain)


def _check_never_chained(connection: Connection, run: str) -> None:
    """Raise StoreError if another run, whose own chain covers this, says that a run without a chain had one."""
    after = select(RunRow.run).where(
        RunRow.before_run == run, RunRow.before_sha256.is_not(None), RunRow.chain.is_not(None)
    )
    if (following := connection.scalar(after.order_by(RunRow.run).limit(1))) is not None:
        raise _broken(
            run, f"its row in runs states no chain, and run {following}, begun after it, names a link of it"
        )


def chain_state(connection: Connection, chain: str | None) -> ChainState:
    """Return the state of a chain that was checked, from column ``runs.chain``."""
    if chain is None:
        return ChainState()
    key_id = key_id_of(chain)
    if not key_id:
        return ChainState("chained")
    return ChainState("chained", "checked" if checking_key(connection, chain) else "not checked", key_id)


def _links(connection: Connection, run: str, kinds: Collection[str]) -> Sequence[Row[*tuple[Any, ...]]]:
    link, before = LinkRow, aliased(LinkRow)
    query = (
        select(*link.__table__.columns, before.sha256.label("before"))
        .outerjoin(before, (before.run == link.run) & (before.number == link.number - 1))
        .where(link.run == run)
        .order_by(link.number)
    )
    if kinds:
        query = query.where(link.kind.in_(kinds))
        if not set(kinds).intersection(MANY_LINKS):
            query = query.where(match_few_links())
    return connection.execute(query).all()


def _check_link(run: str, link: Row[*tuple[Any, ...]], key_id: str, key: SigningKey | None) -> None:
    """Raise StoreError if a link was moved or changed, or its signature does not match the run's state."""
    what = f"link {link.number} in run_links, of {name_document(link.kind, link.document)}"
    if link.number and link.before is None:
        raise _broken(run, f"link {link.number - 1} in run_links is missing")
    if link.sha256 != link_digest(link.before or "", link.kind, link.document, link.content_sha256):
        raise _broken(run, f"{what}, does not follow from the link before it")
    if (link.mac is not None) is not bool(key_id):
        raise _broken(run, f"{what}, is {'not ' if key_id else ''}signed, unlike its run")
    if key is not None and not key.verify(run, link.sha256, link.mac):
        raise _broken(run, f"{what}, was not signed with key {key.key_id}")


def _check_rows(connection: Connection, run: str, kinds: Collection[str], linked: dict[tuple[str, str], str]) -> None:
    """Raise StoreError if rows were changed, added or removed."""
    figure_links = {place: linked.pop(place) for place in list(linked) if place[0] == FIGURES}
    query = select(AnalysisRow.analysis).where(AnalysisRow.run == run)
    analyses = connection.scalars(query).all() if FIGURES in kinds else ()
    figures = ((FIGURES, analysis, figures_digest(connection, analysis)) for analysis in analyses)
    for stored, links in ((digest_documents(connection, run, kinds), linked), (figures, figure_links)):
        for kind, document, content in stored:
            expected = links.pop((kind, document), None)
            if expected is None:
                raise _broken(run, f"{name_document(kind, document)} was added: no link covers it")
            if expected != content:
                raise _broken(run, f"{name_document(kind, document)} was changed: it does not match its digest")
        for kind, document in links:
            raise _broken(run, f"{name_document(kind, document)} was removed: its link is there, the row is not")


def among(connection: Connection, column: Any, runs: Collection[str]) -> ColumnElement[bool]:
    """Select the rows of some runs.

    PostgreSQL takes 30 ms for a thousand names, and may read the whole table: runs that follow each other are
    selected by the first and the last of them.
    """
    if connection.dialect.name != "postgresql" or len(runs) < _MIN_RANGE:
        return and_(column.in_(runs))
    first, last = min(runs), max(runs)
    between = connection.scalar(select(func.count()).select_from(RunRow).where(RunRow.run.between(first, last)))
    span = column.between(first, last)
    return span if between == len(runs) else and_(span, column.in_(runs))


def runs_with_a_gap(connection: Connection, runs: Sequence[str]) -> set[str]:
    """Return the runs that lack a link from their last state on, where their results are."""
    link = LinkRow
    of_states = select(link.run, func.max(link.number).label("number")).where(
        among(connection, link.run, runs), link.kind == RunStateRow.__tablename__, match_few_links()
    )
    last = of_states.group_by(link.run).subquery()
    query = (
        select(link.run)
        .join(last, (last.c.run == link.run) & (link.number >= last.c.number))
        .where(among(connection, link.run, runs))
        .group_by(link.run)
        .having(func.count() != func.max(link.number) - func.min(link.number) + 1)
    )
    return set(connection.scalars(query))


def digest_documents(
    connection: Connection, run: str, kinds: Collection[str] = ALL_KINDS
) -> Iterator[tuple[str, str, str]]:
    """Yield kind, key and content digest of the stored documents of a run, figures left out."""
    for table in (table for table in tables() if table.name in kinds):
        # Every number but 0 is read as true, so the flag itself selects the rows.
        columns = (
            type_coerce(column, Integer).label(column.name) if isinstance(column.type, Boolean) else column
            for column in list_covered(table)
        )
        query = select(*columns).where(select_run(table, run))
        for key, content in documents(table, connection.execute(query).mappings()):
            yield table.name, key, content


def select_run(table: Table, run: str) -> Any:
    """Select a run's rows of a table: by run, analysis or calibration."""
    if "run" in table.columns:
        return table.c.run == run
    (name,) = KEYS[table.name]
    owner = AnalysisRow if name == "analysis" else CalibrationRow
    return table.c[name].in_(select(getattr(owner, name)).where(owner.run == run))


def _broken(run: str, problem: str) -> StoreError:
    return StoreError(f"run {run}: {problem}", remedy=RESTORE)
