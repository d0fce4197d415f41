"""Real matrices in MATLAB files of version 5 (saved with -v6 or -v7), and nothing else that such a file may hold.

Structures, cells and objects are skipped unread: nested thousands deep, they exhaust the stack of any reader. Packed
variables are unpacked only when their header says a size that a file of this length may have.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.untrusted import largest_content

HEADER_BYTES: Final = 128
_MATRIX: Final = 14
_PACKED: Final = 15
#: Bytes of a packed variable that hold its header, whatever its name.
_BEGINNING: Final = 1024
_MOST_VARIABLES: Final = 10_000
_NUMERIC_CLASSES: Final = range(6, 16)
_COMPLEX: Final = 0x0800
_LOGICAL: Final = 0x0200
_TYPES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}


@dataclass(frozen=True, slots=True)
class _Variable:
    """A variable's header: its values are the ``size_bytes`` behind byte ``start`` of its element."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    start: int
    size_bytes: int
    is_complex: bool


def real_matrices(data: bytes, rows: int) -> tuple[dict[str, NDArray[np.float64]], tuple[str, ...]]:
    """Read the matrices of some rows and at least one column.

    Parameters
    ----------
    data : the whole file.

    Returns
    -------
    The real ones in the file's order, (rows, n) float64, and the names of complex ones, which are not read.

    Raises
    ------
    ValueError
        If the file is cut or damaged, or claims more than a file of its length may hold.
    """
    found: dict[str, NDArray[np.float64]] = {}
    complex_ones: list[str] = []
    left = largest_content(len(data))
    for element, packed, order in _elements(data):
        variable = _header(_unpacked(element, _BEGINNING) if packed else element[:_BEGINNING], order)
        if variable is None or len(variable.shape) != 2 or variable.shape[0] != rows or not variable.shape[1]:
            continue
        if variable.is_complex:
            complex_ones.append(variable.name)
            continue
        left -= 8 * rows * variable.shape[1]
        if left < 0:
            raise ValueError(f"{variable.name} of {variable.shape} is too large for a file of {len(data)} bytes")
        if variable.size_bytes != rows * variable.shape[1] * np.dtype(variable.dtype).itemsize:
            raise ValueError(f"{variable.name} of {variable.shape} holds {variable.size_bytes} bytes")
        end = variable.start + variable.size_bytes
        values = (_unpacked(element, end) if packed else element)[variable.start : end]
        if len(values) != variable.size_bytes:
            raise ValueError(f"{variable.name} is cut")
        flat = np.frombuffer(values, dtype=variable.dtype)
        found[variable.name] = flat.astype(np.float64).reshape(variable.shape, order="F")
    return found, tuple(complex_ones)


def _elements(data: bytes) -> Iterator[tuple[memoryview, bool, str]]:
    """Yield each variable's bytes, whether they are packed, and the byte order."""
    order = {b"IM": "<", b"MI": ">"}.get(data[126:HEADER_BYTES])
    if order is None:
        raise ValueError("its header states no byte order of version 5")
    at, count, view = HEADER_BYTES, 0, memoryview(data)
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        count += 1
        if kind not in (_MATRIX, _PACKED) or count > _MOST_VARIABLES:
            raise ValueError(f"no variable begins at byte {at}")
        if at + 8 + length > len(data):
            raise ValueError(f"the variable at byte {at} is cut")
        # Of what is packed, the first eight bytes repeat the kind and length of what is not.
        yield view[at + 8 : at + 8 + length], kind == _PACKED, order
        at += 8 + length


def _unpacked(element: memoryview, most: int) -> memoryview:
    """The first bytes of a packed variable, behind its tag."""
    try:
        return memoryview(zlib.decompressobj().decompress(element, most + 8))[8:]
    except zlib.error as error:
        raise ValueError(f"a variable cannot be unpacked: {error}") from error


def _header(element: memoryview, order: str) -> _Variable | None:
    """Read the header of a variable; None where it is no array of numbers."""
    try:
        flags = struct.unpack_from(f"{order}I", element, 8)[0]
        if flags & 0xFF not in _NUMERIC_CLASSES or flags & _LOGICAL:
            return None
        _, start, length, at = _part(element, 16, order)
        shape = struct.unpack_from(f"{order}{length // 4}i", element, start)
        _, start, length, at = _part(element, at, order)
        name = bytes(element[start : start + length]).decode("ascii", errors="replace")
        kind, start, length, _ = _part(element, at, order)
    except struct.error as error:
        raise ValueError("the header of a variable is cut") from error
    if kind not in _TYPES or min(shape, default=-1) < 0:
        raise ValueError(f"{name} of {shape} holds values of the unknown type {kind}")
    return _Variable(name, shape, order + _TYPES[kind], start, length, bool(flags & _COMPLEX))


def _part(element: memoryview, at: int, order: str) -> tuple[int, int, int, int]:
    """Kind, start and length of a part of a variable, and where the next begins."""
    kind, length = struct.unpack_from(f"{order}II", element, at)
    if kind >> 16:  # a short one: up to four bytes, within the tag
        return kind & 0xFFFF, at + 4, min(kind >> 16, 4), at + 8
    return kind, at + 8, length, at + 8 + (length + 7) // 8 * 8
