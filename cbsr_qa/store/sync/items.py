"""What is sent besides runs: station checks, references of charts, releases; none of them ever changes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Connection, Row

from cbsr_qa.store.chain.many_rows import row_texts
from cbsr_qa.store.chain.run_documents import sha256
from cbsr_qa.store.outbox import Kind
from cbsr_qa.store.sync.rows import columns_of, raw_select
from cbsr_qa.store.tables.records import (
    ChartReferenceRow,
    ReleaseRow,
    StationCheckFramesRow,
    StationCheckLineRow,
    StationCheckRow,
)
from cbsr_qa.store.tables.runs import Base

#: Tables of each kind, the first with a row of the item itself.
_TABLES: Final[Mapping[Kind, tuple[type[Base], ...]]] = {
    Kind.STATION_CHECK: (StationCheckRow, StationCheckLineRow, StationCheckFramesRow),
    Kind.CHART_REFERENCE: (ChartReferenceRow,),
    Kind.RELEASE: (ReleaseRow,),
}
_RUNS: Final = ("golden_run", "first_run", "last_run")


@dataclass(frozen=True, slots=True)
class Item:
    """Rows of an item by table.

    Parameters
    ----------
    sha256 : of its rows; bytes have their own digest in the same row.
    runs : that it refers to.
    """

    station: str
    sha256: str
    rows: Mapping[str, Sequence[Row[Any]]]
    runs: tuple[str, ...]


def read_item(connection: Connection, kind: Kind, name: str) -> Item | None:
    """Return an item, or None."""
    head, *_ = tables = [Base.metadata.tables[model.__tablename__] for model in _TABLES[kind]]
    (key,) = head.primary_key.columns.keys()
    rows = {table.name: connection.execute(raw_select(table).where(table.c[key] == name)).all() for table in tables}
    if not rows[head.name]:
        return None
    own = rows[head.name][0]._mapping
    texts = [text for table in tables for text in row_texts(table, columns_of(table, rows[table.name]))]
    return Item(
        own.get("station", ""),
        sha256(*sorted(texts)),
        {name: table_rows for name, table_rows in rows.items() if table_rows},
        tuple(run for column in _RUNS if (run := own.get(column)) is not None),
    )
