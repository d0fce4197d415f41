"""Parcels and items added to the central database, each in one transaction; PostgreSQL takes rows by COPY."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from sqlalchemy import (
    Connection,
    Engine,
    Row,
    bindparam,
    insert,
    select,
    text,
)
from sqlalchemy.exc import DataError, DBAPIError, IntegrityError, StatementError

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store.damage import name_database
from cbsr_qa.store.engine import writing
from cbsr_qa.store.outbox import Kind
from cbsr_qa.store.sync.copying import copy_rows
from cbsr_qa.store.sync.items import Item, read_item
from cbsr_qa.store.sync.parcels import AlteredError, Parcel
from cbsr_qa.store.sync.rows import columns_of, counts_of
from cbsr_qa.store.tables.records import ConfigurationChangeRow
from cbsr_qa.store.tables.runs import Base, RunRow, SensorRow


class RowRefusedError(StoreError):
    """The centre refuses a row: a constraint, a type or a length."""


class WaitsError(StoreError):
    """What is to be stored refers to a run that the centre does not have."""


def store_parcel(engine: Engine, parcel: Parcel) -> None:
    """Store a parcel in one transaction.

    Raises
    ------
    RowRefusedError, AlteredError, WaitsError
        If it does not fit what is stored; nothing of it is stored then.
    StoreError
        If the database cannot be reached or written.
    """
    with _begin_transaction(engine) as connection:
        changes = parcel.rows.get(ConfigurationChangeRow.__tablename__, ())
        column = ConfigurationChangeRow.__table__.columns.keys().index("earlier_run")
        _check_runs(connection, [row[column] for row in changes])
        if parcel.sensor is not None:
            _add_sensor(connection, parcel.sensor)
        _add_rows(connection, parcel.rows)
        if parcel.counts:
            _compare_counts(connection, parcel)


def store_item(engine: Engine, kind: Kind, name: str, item: Item) -> bool:
    """Store a station check, a reference of a chart or a release; errors as :func:`store_parcel`.

    Returns
    -------
    False if the centre had it.
    """
    with _begin_transaction(engine) as connection:
        stored = read_item(connection, kind, name)
        if stored is None:
            _check_runs(connection, item.runs)
            _add_rows(connection, item.rows)
        elif stored.sha256 != item.sha256:
            raise AlteredError(f"{kind} {name} differs from the centre's", item.sha256, stored.sha256)
    return stored is None


@contextmanager
def _begin_transaction(engine: Engine) -> Iterator[Connection]:
    """Begin a transaction in which a row that does not fit raises RowRefusedError."""
    with writing(engine) as connection:
        try:
            yield connection
        except (IntegrityError, DataError) as error:
            raise RowRefusedError(
                f"{name_database(engine.url)} refuses a row: {_driver_words(error.orig)}"
            ) from error
        except (StatementError, UnicodeError, OverflowError) as error:
            if isinstance(error, DBAPIError):
                raise
            raise RowRefusedError(
                f"{name_database(engine.url)} cannot hold a value: {_driver_words(error)}"
            ) from error


def _driver_words(error: object) -> str:
    """First line of a driver's message, and its detail, which names the key."""
    lines = str(error).strip().splitlines() or ["no reason given"]
    return "; ".join(" ".join(line.split())[:200] for line in lines[:2])


def _check_runs(connection: Connection, runs: Sequence[str]) -> None:
    if runs:
        known = set(connection.scalars(select(RunRow.run).where(RunRow.run.in_(runs))))
        missing = [run for run in runs if run not in known]
        if missing:
            raise WaitsError(f"it refers to run {missing[0]}, which the centre does not have")


def _add_sensor(connection: Connection, sensor: Row[Any]) -> None:
    """Add a sensor that is unknown."""
    row, values = SensorRow, sensor._asdict()
    columns, parameters = ", ".join(values), ", ".join(f":{name}" for name in values)
    statement = text(f"INSERT INTO sensors ({columns}) VALUES ({parameters}) ON CONFLICT DO NOTHING")
    typed = [bindparam(column.name, type_=column.type) for column in row.__table__.columns]
    connection.execute(statement.bindparams(*typed), values)
    stored = connection.execute(select(*row.__table__.columns).where(row.serial == sensor.serial)).one()
    for name in ("batch", "sensor_type"):
        there = getattr(stored, name)
        if there != values[name]:
            raise AlteredError(
                f"sensor {sensor.serial} has {name} {there!r} at the centre, and {values[name]!r} here"
            )


def _add_rows(connection: Connection, parcel_rows: Mapping[str, Sequence[Sequence[Any]]]) -> None:
    for name, rows in parcel_rows.items():
        table = Base.metadata.tables[name]
        if connection.dialect.name == "postgresql":
            copy_rows(connection, table, rows)
        else:
            columns = columns_of(table, rows)
            values = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
            connection.execute(insert(table), values)


def _compare_counts(connection: Connection, parcel: Parcel) -> None:
    """Refuse a run of which the centre has more or fewer rows than the station: digests of links say the rest."""
    names = list(parcel.counts)
    stored = counts_of(connection, parcel.run, names)
    for name in names:
        if stored[name] != parcel.counts[name]:
            raise AlteredError(
                f"run {parcel.run}: {name} has {parcel.counts[name]} rows at the station and {stored[name]} at the"
                " centre with all of its links"
            )
