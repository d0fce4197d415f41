"""Conversion between table rows and domain dataclasses; equal names hold equal content."""

from enum import StrEnum
from typing import Any, TypeVar

from sqlalchemy import Row

from cbsr_qa.domain.filling import fill_from_mapping

T = TypeVar("T")


def convert_row(kind: type[T], row: Row[Any], /, **others: Any) -> T:
    """Return a dataclass of the columns that have the names of its fields; ``others`` take precedence.

    Raises
    ------
    KeyError, TypeError, ValueError
        If the JSON of a column does not fit the field's type.
    """
    return fill_from_mapping(kind, dict(row._mapping), **others)


def row_of(table: Any, source: object, /, **others: Any) -> dict[str, Any]:
    """Return the columns of a table that ``source`` has as attributes; ``others`` take precedence."""
    names = [column.name for column in table.__table__.columns]
    columns = {
        name: _as_stored(getattr(source, name)) for name in names if name not in others and hasattr(source, name)
    }
    return columns | others


def _as_stored(value: Any) -> Any:
    if isinstance(value, StrEnum):
        return str(value)
    return [_as_stored(item) for item in value] if isinstance(value, tuple) else value
