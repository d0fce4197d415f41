"""Verification of some documents of many runs at once: the rows a list shows, against the links of these documents.

A whole chain takes 20 ms a run, most of it for links of frames. Here a link is compared with the one before it only.
"""

import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import NoneType
from typing import Any, Final, Self, TypeAlias

from sqlalchemy import JSON, Boolean, Connection, Integer, Table, Text, and_, cast, select, type_coerce
from sqlalchemy.orm import aliased
from sqlalchemy.types import NullType

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store.chain.check import among, check_run, runs_with_a_gap
from cbsr_qa.store.chain.links import key_id_of, link_digest, match_few_links, signing_key
from cbsr_qa.store.chain.many_rows import documents_in_columns, keys_of
from cbsr_qa.store.chain.run_documents import list_covered
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.store.tables.results import AnalysisRow
from cbsr_qa.store.tables.runs import Base, RunRow
from cbsr_qa.store.types import Digest, FiniteDouble, Instant, PlainText, Whole, Word

#: Runs whose rows are in memory at once.
RUNS_AT_ONCE: Final = 1000

#: Types of the cells that a driver returns, by the type of their column.
_CELLS: Final[tuple[tuple[Any, tuple[type, ...]], ...]] = (
    (FiniteDouble, (float, int)),
    ((Whole, Boolean), (int,)),
    (Digest, (bytes,)),
    ((PlainText, Word), (str,)),
)

#: (run, table, key of a document).
_Place: TypeAlias = tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class ReadRows:
    """Rows of some runs of one table: the columns that the chain covers, and the run of each row."""

    table: Table
    runs: Sequence[str]
    columns: Mapping[str, Sequence[Any]]

    def tuples(self, names: Sequence[str]) -> Iterator[tuple[Any, ...]]:
        """Yield the cells of some columns, row by row."""
        return zip(*(self.columns[name] for name in names), strict=True)

    def select_runs(self, runs: Collection[str]) -> Self:
        """Return the rows of some of the runs."""
        indexes = [place for place, run in enumerate(self.runs) if run in runs]
        if len(indexes) == len(self.runs):
            return self
        columns = {name: [cells[place] for place in indexes] for name, cells in self.columns.items()}
        return replace(self, runs=[self.runs[place] for place in indexes], columns=columns)

    def digests(self) -> Iterator[tuple[_Place, str]]:
        """Yield the digest of every document among the rows."""
        if not self.runs:
            return
        keys = [f"{run}\n{key}" for run, key in zip(self.runs, keys_of(self.table, self.columns), strict=True)]
        for key, content in documents_in_columns(self.table, self.columns, keys).items():
            run, _, document = key.partition("\n")
            yield (run, self.table.name, document), content


def read_rows(connection: Connection, kind: type[Base], runs: Sequence[str]) -> ReadRows:
    """Read the rows of some runs, by run and key.

    JSON that several rows share is parsed once: they share the object.

    Raises
    ------
    TypeError, ValueError
        If a cell holds a value of another type than its column.
    """
    table = Base.metadata.tables[kind.__tablename__]
    owner: Any = table.c.run if "run" in table.columns else AnalysisRow.run
    query = select(
        type_coerce(owner, NullType()).label("of_run"), *(_readable(column) for column in list_covered(table))
    )
    if "run" not in table.columns:
        query = query.join(AnalysisRow, AnalysisRow.analysis == table.c.analysis)
    query = query.where(among(connection, owner, runs)).order_by(owner, *table.primary_key.columns)
    rows = connection.execute(query).all()
    own, *cells = zip(*rows, strict=True) if rows else [()] * (len(list_covered(table)) + 1)
    columns = {
        column.name: _convert_cells(column, column_cells)
        for column, column_cells in zip(list_covered(table), cells, strict=True)
    }
    return ReadRows(table, own, columns)


def _readable(column: Any) -> Any:
    """Select a column as the driver returns it: types are checked of whole columns, which takes no time."""
    if isinstance(column.type, JSON):
        return cast(column, Text).label(column.name)
    if isinstance(column.type, Instant):
        return column
    # Every number but 0 would be read as true.
    kind = Integer() if isinstance(column.type, Boolean) else NullType()
    return type_coerce(column, kind).label(column.name)


def _convert_cells(column: Any, cells: Sequence[Any]) -> Sequence[Any]:
    """Return cells as their column holds them. TypeError or ValueError for one of another type."""
    if isinstance(column.type, JSON):
        parsed = {text: json.loads(text) for text in set(cells) if text is not None}
        return [None if text is None else parsed[text] for text in cells]
    allowed = next((kinds for kind, kinds in _CELLS if isinstance(column.type, kind)), (object,))
    for cell_type in set(map(type, cells)):
        if not issubclass(cell_type, (*allowed, NoneType)):
            raise TypeError(f"a cell of {column} holds {cell_type.__name__}")
    return [cell and cell.hex() for cell in cells] if isinstance(column.type, Digest) else cells


def find_altered(
    connection: Connection, chains: Mapping[str, str | None], tables: Iterable[ReadRows], *, ended: bool = False
) -> dict[str, str]:
    """Compare rows with their links.

    A run that does not match is checked as a whole, which names what was altered.

    Parameters
    ----------
    chains : column ``runs.chain`` of every run that was read.
    tables : all rows of these runs in some tables.
    ended : whether no link may be missing from a run's last state on, where its results are.

    Returns
    -------
    What is wrong, by run; runs that are sound are absent.
    """
    stored: defaultdict[str, dict[_Place, str]] = defaultdict(dict)
    kinds = []
    for rows in tables:
        kinds.append(rows.table.name)
        for place, content in rows.digests():
            stored[place[0]][place] = content
    linked, doubted = _read_links(connection, chains, kinds)
    doubted |= {run for run, chain in chains.items() if linked.get(run, {}) != (stored[run] if chain else {})}
    doubted |= _find_unchained(connection, {run for run, chain in chains.items() if not chain})
    if ended:
        doubted |= runs_with_a_gap(connection, [run for run, chain in chains.items() if chain])
    return dict(_problems(connection, sorted(doubted), kinds))


def _find_unchained(connection: Connection, unchained: set[str]) -> set[str]:
    """Return the runs whose row states no chain, although links of any kind, or another run, say that it had one.

    The run begun next names the digest of the last link that it then had, which its own chain covers.
    """
    if not unchained:
        return set()
    runs, after = sorted(unchained), aliased(RunRow)
    links = select(LinkRow.run).where(among(connection, LinkRow.run, runs)).distinct()
    named = select(after.before_run).where(
        among(connection, after.before_run, runs), after.before_sha256.is_not(None), after.chain.is_not(None)
    )
    return unchained.intersection([*connection.scalars(links), *connection.scalars(named)])


def _read_links(
    connection: Connection, chains: Mapping[str, str | None], kinds: Collection[str]
) -> tuple[dict[str, dict[_Place, str]], set[str]]:
    """Return the content of every document that a link names, and the runs of links that do not follow."""
    link, before = LinkRow, aliased(LinkRow)
    names = "run", "number", "kind", "document", "content_sha256", "sha256", "mac"
    columns: list[Any] = [*(getattr(link, name) for name in names), before.sha256]
    query = (
        select(*(type_coerce(column, NullType()) for column in columns))
        .outerjoin(
            before,
            and_(before.run == link.run, before.number == link.number - 1, among(connection, before.run, chains)),
        )
        .where(among(connection, link.run, chains), link.kind.in_(kinds), match_few_links())
    )
    linked: defaultdict[str, dict[_Place, str]] = defaultdict(dict)
    doubted, key = set(), signing_key(connection)
    key_ids = {run: key_id_of(chain or "") for run, chain in chains.items()}
    for run, number, kind, document, content_sha256, own, mac, earlier in map(tuple, connection.execute(query).all()):
        content = content_sha256.hex()
        linked[run][run, kind, document] = content
        sound = (earlier is None) is (number == 0) and (mac is not None) is bool(key_ids[run])
        if sound and key is not None and key.key_id == key_ids[run]:
            sound = key.verify(run, own.hex(), mac.hex())
        if not sound or own.hex() != link_digest("" if earlier is None else earlier.hex(), kind, document, content):
            doubted.add(run)
    return linked, doubted


def _problems(connection: Connection, runs: Sequence[str], kinds: Collection[str]) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with each run, if anything is: of what was read first."""
    for run in runs:
        try:
            check_run(connection, run, kinds)
            check_run(connection, run)
        except StoreError as error:
            yield run, error.reason
