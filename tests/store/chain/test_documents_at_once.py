"""Digests that are computed column by column are those of the rows one by one."""

from datetime import UTC

import sqlalchemy as sa
from hypothesis import given, strategies as st

from cbsr_qa.store.chain.many_rows import documents_in_columns, keys_of, row_texts
from cbsr_qa.store.chain.run_documents import KEYS, documents, list_covered, row_text
from cbsr_qa.store.tables.runs import Base
from cbsr_qa.store.types import FiniteDouble, Instant, Whole

LINKED = [Base.metadata.tables[name] for name in KEYS]
WORDS = st.sampled_from(["", "a", "α\n", '"', "\0"])
#: Cells as SQLite may hold them: of the column's type, of another, and equal ones of unlike types.
FOREIGN = st.sampled_from([None, 1, 1.0, True, 0.5, "1", b"\xff", float("inf")])


def cells(kind):
    if isinstance(kind, FiniteDouble):
        return st.sampled_from([0.0, -0.0, 0.1, 1e300, -5e-324])
    if isinstance(kind, Instant):
        return st.datetimes(timezones=st.just(UTC))
    if isinstance(kind, sa.JSON):
        return st.sampled_from([[], {"b": [1.5, None], "a": "α"}, [["x", 0.1]]])
    if isinstance(kind, sa.Boolean):
        return st.sampled_from([0, 1])
    return st.sampled_from([0, 3, -(2**31)]) if isinstance(kind, Whole) else WORDS


def typed(kind):
    return isinstance(kind, sa.JSON | Instant)


@given(st.sampled_from(LINKED), st.data())
def test_documents_are_those_of_rows_one_by_one(table, data):
    count = data.draw(st.integers(0, 12))
    columns = {}
    for one in list_covered(table):
        own = cells(one.type) | st.none()
        cell = data.draw(st.sampled_from([own, own if typed(one.type) else own | FOREIGN]))
        columns[one.name] = data.draw(st.lists(cell, min_size=count, max_size=count))
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    assert row_texts(table, columns) == [row_text(table, row) for row in rows]
    assert documents_in_columns(table, columns, keys_of(table, columns)) == dict(documents(table, rows))
