"""Column types that behave alike on SQLite and PostgreSQL, and let no NaN and no foreign number type through."""

import re
from datetime import UTC, datetime
from typing import Any, Final

from sqlalchemy import DateTime, Dialect, Double, Integer, Text
from sqlalchemy.types import TypeDecorator

_NO_TEXT: Final = re.compile("[\0\ud800-\udfff]")


class FiniteDouble(TypeDecorator[float]):
    """A double that is a number: numpy scalars become plain floats, NaN and infinity are refused."""

    impl = Double
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: Dialect) -> float | None:
        """Check and convert on the way in."""
        if value is None:
            return None
        number = float(value)
        if not abs(number) < float("inf"):
            raise ValueError(f"{number} is not a finite number and is not stored")
        return number


class Whole(TypeDecorator[int]):
    """An integer; numpy's own kinds would reach SQLite as bytes."""

    impl = Integer
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: Dialect) -> int | None:
        """Convert on the way in."""
        return None if value is None else int(value)


class PlainText(TypeDecorator[str]):
    """Text of any length. PostgreSQL takes no NUL and no database halves of characters: U+FFFD stands for each."""

    impl = Text
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: Dialect) -> str | None:
        """Replace on the way in."""
        return None if value is None else _NO_TEXT.sub("\ufffd", str(value))


class Instant(TypeDecorator[datetime]):
    """A moment with its zone, kept in UTC; SQLite itself knows no zones."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: Dialect) -> datetime | None:
        """Convert to UTC on the way in; a time without a zone is refused."""
        if value is None:
            return None
        if not isinstance(value, datetime) or value.tzinfo is None:
            raise ValueError(f"{value!r} is not a time with a zone and is not stored")
        instant = value.astimezone(UTC)
        return instant.replace(tzinfo=None) if dialect.name == "sqlite" else instant

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Return it with its zone."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)
