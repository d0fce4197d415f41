"""Arrays as bytes: little-endian, C order, with a digest over what they are as well as what they hold."""

import hashlib
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray


def packed(values: NDArray[np.float64]) -> bytes:
    """Return float64 as little-endian bytes in C order."""
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def packed_flags(values: NDArray[np.uint8]) -> bytes:
    """Return uint8 as bytes in C order."""
    return np.ascontiguousarray(values, dtype=np.uint8).tobytes()


def unpacked(data: bytes, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return float64 of a shape from little-endian bytes; a copy that may be written to.

    Raises
    ------
    ValueError
        If the bytes are too few or too many for the shape.
    """
    return np.frombuffer(data, dtype="<f8").reshape(shape).astype(np.float64)


def unpacked_flags(data: bytes, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return uint8 of a shape from bytes; a copy. Raises ValueError as :func:`unpacked`."""
    return np.frombuffer(data, dtype=np.uint8).reshape(shape).copy()


def digest(header: str, parts: Iterable[bytes]) -> str:
    """SHA-256 over a description (unit, shape, current…) and the bytes it describes, hexadecimal."""
    total = hashlib.sha256(header.encode())
    for part in parts:
        total.update(len(part).to_bytes(8, "little"))
        total.update(part)
    return total.hexdigest()
