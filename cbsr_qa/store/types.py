"""Column types: numbers, texts, instants, identifiers, and arrays as bytes.

Column types behave alike on SQLite and PostgreSQL. They refuse NaN and foreign number types when writing, and when
reading refuse cells of another type, which SQLite allows.

Identifiers are time-ordered (UUID version 7, RFC 9562): databases of stations merge without collision, and rows sort
by age. Arrays are little-endian and in C order.
"""

import hashlib
import re
import secrets
import zlib
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from threading import Lock
from typing import Any, Final, TypeVar
from uuid import UUID

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import DateTime, Dialect, Double, Integer, LargeBinary, String, Text
from sqlalchemy.types import TypeDecorator

from cbsr_qa.domain.numbers import Array

_COUNTER_BITS = 12
#: Window bits for zlib without header and checksum: the digest of a row covers what is packed.
_NO_HEADER: Final = -15
#: Number of cells restored at once: few enough to stay in the processor's cache.
_CELLS_AT_ONCE: Final = 128
#: First millisecond of the year 10000: an identifier can encode later years than a date.
_YEAR_10000_MS = 253_402_300_800_000


class IdSource:
    """Creates identifiers that increase within one source, even if the wall clock goes back.

    The 12 bits after the version count within a millisecond (RFC 9562, 6.2, method 1), starting from a random number
    whose highest bit is 0; if the clock stands still or is set back, the last millisecond is kept and the count
    continues.

    Parameters
    ----------
    wall : function that returns date and time.
    """

    def __init__(self, wall: Callable[[], datetime]) -> None:
        self._wall = wall
        self._last_ms = -1
        self._counter = 0
        self._lock = Lock()

    def follow(self, latest: str) -> None:
        """Make all later identifiers sort after ``latest``, even if the clock was set back.

        Parameters
        ----------
        latest : an identifier; ignored if it is not of this kind.
        """
        parts = _parts(latest)
        with self._lock:
            if parts is not None and parts > (self._last_ms, self._counter):
                self._last_ms, self._counter = parts

    def new(self) -> str:
        now_ms = int(self._wall().timestamp() * 1000)
        with self._lock:
            if now_ms > self._last_ms:
                self._last_ms, self._counter = now_ms, secrets.randbits(_COUNTER_BITS - 1)
            else:
                self._counter += 1
                if self._counter >> _COUNTER_BITS:
                    self._last_ms, self._counter = self._last_ms + 1, secrets.randbits(_COUNTER_BITS - 1)
            millisecond, counter = self._last_ms, self._counter
        return str(UUID(int=millisecond << 80 | 7 << 76 | counter << 64 | 2 << 62 | secrets.randbits(62)))


def first_id(moment: datetime) -> str:
    """Return a text that sorts before every identifier made at a moment or later."""
    digits = f"{max(int(moment.timestamp() * 1000), 0):012x}"
    return f"{digits[:8]}-{digits[8:]}"


def time_of_id(identifier: str) -> datetime | None:
    """Return the creation time in an identifier, by its maker's clock; None if it has none."""
    parts = _parts(identifier)
    if parts is None or parts[0] >= _YEAR_10000_MS:
        return None
    return datetime.fromtimestamp(parts[0] / 1000, UTC)


def _parts(identifier: str) -> tuple[int, int] | None:
    """Return millisecond and counter of an identifier; None if it is not of version 7."""
    try:
        number = UUID(identifier)
    except ValueError:
        return None
    if number.version != 7:
        return None
    return number.int >> 80, (number.int >> 64) & ((1 << _COUNTER_BITS) - 1)


def pack(values: Array) -> bytes:
    """Return float64 as little-endian bytes in C order."""
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def pack_flags(values: NDArray[np.uint8]) -> bytes:
    """Return uint8 as bytes in C order."""
    return np.ascontiguousarray(values, dtype=np.uint8).tobytes()


def unpack(data: bytes, shape: tuple[int, ...]) -> Array:
    """Return float64 of a shape from little-endian bytes, as a writable copy.

    Raises
    ------
    ValueError
        If the number of bytes does not fit the shape.
    """
    return np.frombuffer(data, dtype="<f8").reshape(shape).astype(np.float64)


def unpack_flags(data: bytes, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return uint8 of a shape from bytes; a copy. ValueError if the number of bytes does not fit the shape."""
    return np.frombuffer(data, dtype=np.uint8).reshape(shape).copy()


def compact(data: bytes, width: int, *, steps: bool = False) -> bytes:
    """Return numbers as stored: deflated, the first bytes of all numbers first, or as they are if that is shorter.

    Parameters
    ----------
    data : little-endian numbers.
    width : bytes of a number.
    steps : whether to store the step from each number to the next instead of the numbers: for times, whose steps
        are alike. This is exact: the bits of a float64 are taken as a 64-bit integer, and integers wrap around.
    """
    if len(data) == width:
        return data
    numbers = np.frombuffer(data, dtype=f"<u{width}")
    if steps:
        original, numbers = numbers, numbers.copy()
        numbers[1:] -= original[:-1]
    columns = numbers.view(np.uint8).reshape(-1, width).T.tobytes()
    deflating = zlib.compressobj(1, wbits=-12, memLevel=6)
    deflated = deflating.compress(columns) + deflating.flush()
    return deflated if len(deflated) < len(data) else data


def restore(data: bytes, size: int, width: int, *, steps: bool = False) -> bytes:
    """Return the numbers that :func:`compact` was given.

    Parameters
    ----------
    size : bytes of all numbers; data of this length are as they were.

    Raises
    ------
    ValueError
        If the data are not of that size.
    """
    if len(data) == size:
        return data
    numbers = _numbers([_inflate(data, size)], width)
    return (np.cumsum(numbers, dtype=numbers.dtype) if steps else numbers).tobytes()


def restore_many(cells: Sequence[bytes], size: int, width: int, *, steps: bool = False) -> list[bytes]:
    """Return the numbers of many cells of one size; takes half the time of :func:`restore` for each cell."""
    if width == 1:  # flags, which are alike in most frames
        restored_by_cell = {cell: restore(cell, size, width, steps=steps) for cell in set(cells)}
        return [restored_by_cell[cell] for cell in cells]
    restored = list(cells)
    places = [place for place, cell in enumerate(cells) if len(cell) != size]
    for start in range(0, len(places), _CELLS_AT_ONCE):
        batch_places = places[start : start + _CELLS_AT_ONCE]
        numbers = _numbers([_inflate(cells[place], size) for place in batch_places], width)
        data = (np.cumsum(numbers, axis=1, dtype=numbers.dtype) if steps else numbers).tobytes()
        for index, place in enumerate(batch_places):
            restored[place] = data[index * size : (index + 1) * size]
    return restored


def _inflate(data: bytes, size: int) -> bytes:
    inflating = zlib.decompressobj(wbits=_NO_HEADER)
    try:
        columns = inflating.decompress(data, size + 1)
    except zlib.error as error:
        raise ValueError(str(error)) from error
    if len(columns) != size or not inflating.eof or inflating.unused_data:
        raise ValueError(f"{len(data)} bytes do not hold {size}")
    return columns


def _numbers(cells: Sequence[bytes], width: int) -> NDArray[Any]:
    """Return an array (cells, n) of numbers; each cell stores the first bytes of all numbers first."""
    significance = np.frombuffer(b"".join(cells), dtype=np.uint8).reshape(len(cells), width, -1)
    return np.ascontiguousarray(significance.transpose(0, 2, 1)).view(f"<u{width}")[..., 0]


def digest(header: str, parts: Iterable[bytes]) -> str:
    """Return the SHA-256 over a description (unit, shape, current…) and the bytes it describes, hexadecimal."""
    total = hashlib.sha256(header.encode())
    for part in parts:
        total.update(len(part).to_bytes(8, "little"))
        total.update(part)
    return total.hexdigest()


_Value = TypeVar("_Value")
_NO_TEXT: Final = re.compile("[\0\ud800-\udfff]")


class _Typed(TypeDecorator[_Value]):
    """A column whose cells have the same type on every database; TypeError for a cell of another type."""

    _kinds: type | tuple[type, ...]

    def process_result_value(self, value: Any, dialect: Dialect) -> _Value | None:
        """Check when reading: SQLite keeps bytes in a text column, and text in a numeric one."""
        foreign = value is not None and not isinstance(value, self._kinds)
        if foreign:
            raise TypeError(f"a cell holds {type(value).__name__}")
        return value  # type: ignore[no-any-return]


class FiniteDouble(_Typed[float]):
    """A finite double: numpy scalars become plain floats, NaN and infinity are refused."""

    impl = Double
    cache_ok = True
    _kinds = (float, int)

    def process_bind_param(self, value: Any, dialect: Dialect) -> float | None:
        """Check and convert when writing."""
        if value is None:
            return None
        number = float(value)
        if not abs(number) < float("inf"):
            raise ValueError(f"{number} is not a finite number; it is not stored")
        return number


class Whole(_Typed[int]):
    """An integer; numpy's integers would reach SQLite as bytes."""

    impl = Integer
    cache_ok = True
    _kinds = int

    def process_bind_param(self, value: Any, dialect: Dialect) -> int | None:
        return None if value is None else int(value)


class Word(_Typed[str]):
    """A short text of limited length: an identifier, a digest, a member of an enumeration."""

    impl = String
    cache_ok = True
    _kinds = str


class Digest(_Typed[str]):
    """A SHA-256 or HMAC-SHA256: 32 bytes in the database, 64 hexadecimal digits in Python."""

    impl = LargeBinary(32)
    cache_ok = True
    _kinds = bytes

    def process_bind_param(self, value: Any, dialect: Dialect) -> Any:
        return None if value is None else bytes.fromhex(value)

    def process_result_value(self, value: Any, dialect: Dialect) -> str | None:
        data: Any = super().process_result_value(value, dialect)
        if data is not None and len(data) != 32:
            raise TypeError(f"a cell holds {len(data)} bytes")
        return None if data is None else data.hex()


class PlainText(_Typed[str]):
    """Text of any length. U+FFFD replaces NUL, which PostgreSQL refuses, and lone surrogates, which all refuse."""

    impl = Text
    cache_ok = True
    _kinds = str

    def process_bind_param(self, value: Any, dialect: Dialect) -> str | None:
        """Replace when writing."""
        return None if value is None else _NO_TEXT.sub("\ufffd", str(value))


class Instant(TypeDecorator[datetime]):
    """A moment with its zone, kept in UTC; SQLite has no zones."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: Dialect) -> datetime | None:
        """Convert to UTC when writing; a time without a zone is refused."""
        if value is None:
            return None
        if not isinstance(value, datetime) or value.tzinfo is None:
            raise ValueError(f"{value!r} has no time zone; it is not stored")
        instant = value.astimezone(UTC)
        return instant.replace(tzinfo=None) if dialect.name == "sqlite" else instant

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)
