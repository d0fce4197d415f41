"""Statements that are given to the driver as they are store and return what SQLAlchemy does."""

from datetime import UTC, datetime

import pytest
from sqlalchemy import JSON, MetaData, Table, bindparam, insert, literal_column, select
from sqlalchemy.exc import IntegrityError, StatementError
from sqlalchemy.schema import Column

from cbsr_qa.store.engine import open_engine, parse_url, writing
from cbsr_qa.store.prepared import prepare
from cbsr_qa.store.types import Digest, FiniteDouble, Instant, PlainText, Whole

_TABLE = Table(
    "of_all_types",
    MetaData(),
    Column("number", Whole, primary_key=True, autoincrement=False),
    Column("value", FiniteDouble),
    Column("said", PlainText),
    Column("at", Instant),
    Column("sha256", Digest),
    Column("given", JSON),
)
_INSERTION = insert(_TABLE).inline()
_ONE = select(*_TABLE.columns).where(_TABLE.c.number == bindparam("wanted")).limit(literal_column("1"))
_ROW = {
    "value": -0.1,
    "said": "Δρ 'quoted' %s ? :name",
    "at": datetime(2026, 11, 27, 8, 30, 0, 123456, tzinfo=UTC),
    "sha256": "ab" * 32,
    "given": {"μ": [1, 2.5, None]},
}


@pytest.fixture
def writer(database_url):
    engine = open_engine(parse_url(database_url))
    with writing(engine) as connection:
        _TABLE.create(connection)
        yield connection
    engine.dispose()


def _insert(connection, *rows):
    prepare(_INSERTION, connection.dialect, tuple(rows[0])).execute(connection, rows)


def test_rows_are_those_that_sqlalchemy_stores(writer):
    rows = [{"number": number, **_ROW} for number in range(4)]
    _insert(writer, rows[0])
    _insert(writer, *rows[1:3])
    writer.execute(_INSERTION, rows[3])
    stored = [tuple(row)[1:] for row in writer.execute(select(_TABLE).order_by(_TABLE.c.number))]
    assert stored == [tuple(_ROW.values())] * 4
    assert prepare(_ONE, writer.dialect).one(writer, {"wanted": 2}) == (2, *_ROW.values())


def test_a_column_that_is_not_given_is_null(writer):
    _insert(writer, {"number": 7})
    assert prepare(_ONE, writer.dialect).one(writer, {"wanted": 7}) == (7, *[None] * 5)


def test_what_a_column_cannot_hold_is_refused(writer):
    with pytest.raises(StatementError, match="nan is not a finite number"):
        _insert(writer, {"number": 0, "value": float("nan")})


def test_errors_of_a_driver_are_those_of_sqlalchemy(writer):
    with pytest.raises(IntegrityError), writer.begin_nested():
        _insert(writer, {"number": 1}, {"number": 1})
