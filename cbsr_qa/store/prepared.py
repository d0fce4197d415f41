"""Statements that come with every frame, compiled once and given to the driver as they are.

A station waits for them between two frames; through SQLAlchemy they take three times as long.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import lru_cache
from typing import Any

from sqlalchemy import Connection, Dialect, Insert, Select
from sqlalchemy.exc import DBAPIError, StatementError


class Prepared:
    """A statement for one driver; values pass through the types of their columns, as in SQLAlchemy.

    Parameters
    ----------
    names : columns that an insertion is given; those of a query are its parameters.
    """

    def __init__(self, statement: Insert | Select[Any], dialect: Dialect, names: Sequence[str] = ()) -> None:
        compiled: Any = statement.compile(dialect=dialect, column_keys=list(names) or None)
        self._text = str(compiled)
        self._dialect = dialect
        binds = {name: compiled.binds[bind.key] for bind, name in compiled.bind_names.items()}
        self._fixed = {name: bind.value for name, bind in binds.items() if not bind.required}
        self._converters = [
            (name, bind.type.dialect_impl(dialect).bind_processor(dialect)) for name, bind in binds.items()
        ]
        self._order: Sequence[str] | None = compiled.positiontup if dialect.positional else None
        columns = statement.selected_columns if isinstance(statement, Select) else ()
        self._types = [column.type.dialect_impl(dialect) for column in columns]

    def execute(self, connection: Connection, rows: Sequence[Mapping[str, Any]]) -> None:
        """Insert rows. Raises what :meth:`Connection.execute` raises."""
        with self._cursor(connection) as cursor:
            if len(rows) == 1:
                cursor.execute(self._text, self._values(rows[0]))
            else:
                cursor.executemany(self._text, list(map(self._values, rows)))

    def one(self, connection: Connection, values: Mapping[str, Any]) -> tuple[Any, ...]:
        """Return the only row of a query. Raises like :meth:`Connection.execute`; TypeError for a foreign cell."""
        with self._cursor(connection) as cursor:
            cursor.execute(self._text, self._values(values))
            (row,), kinds = cursor.fetchall(), [column[1] for column in cursor.description]
        converters = [
            column_type.result_processor(self._dialect, kind)
            for column_type, kind in zip(self._types, kinds, strict=True)
        ]
        return tuple(map(_convert_value, converters, row))

    def _values(self, row: Mapping[str, Any]) -> Any:
        cells = {**self._fixed, **row}
        try:
            values = {name: _convert_value(convert, cells[name]) for name, convert in self._converters}
        except (TypeError, ValueError) as error:
            raise StatementError(str(error), self._text, None, error) from error
        return values if self._order is None else [values[name] for name in self._order]

    @contextmanager
    def _cursor(self, connection: Connection) -> Iterator[Any]:
        errors = self._dialect.loaded_dbapi.Error
        try:
            with closing(connection.connection.cursor()) as cursor:
                yield cursor
        except errors as error:
            raise DBAPIError.instance(self._text, None, error, errors, dialect=self._dialect) from error


def _convert_value(convert: Callable[[Any], Any] | None, value: Any) -> Any:
    return value if convert is None else convert(value)


@lru_cache(maxsize=64)
def prepare(statement: Insert | Select[Any], dialect: Dialect, names: tuple[str, ...] = ()) -> Prepared:
    """Return a statement for a driver. Statements that are kept as constants are compiled once."""
    return Prepared(statement, dialect, names)
