"""Interpolation between the nodes of a lattice by cubic convolution (Keys 1981)."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Coefficients of the weights of cubic convolution by powers of the part of a cell, and of their slopes.
_COEFFICIENTS: Final = (
    np.array(
        [
            [0, 2, 0, 0, -1, 0, 1, 0],
            [-1, 0, 1, 0, 4, -10, 8, -2],
            [2, -5, 4, -1, -3, 9, -9, 3],
            [-1, 3, -3, 1, 0, 0, 0, 0],
        ]
    )
    / 2.0
)


def weights_at(part: Array) -> Array:
    """Weights of cubic convolution at parts (…) of a cell, and their slopes per cell: (…, 2, 4)."""
    powers = np.empty((*part.shape, 4))
    powers[..., 0], powers[..., 1] = 1.0, part
    np.multiply(part, part, out=powers[..., 2])
    np.multiply(powers[..., 2], part, out=powers[..., 3])
    both: Array = powers @ _COEFFICIENTS
    return both.reshape(*part.shape, 2, 4)


def surfaces_at(tables: Array, offset: Array) -> Array:
    """Interpolate tables (n, 16, k) about cells at offsets (n, 2) from their corners.

    Returns
    -------
    (n, 4, k) value, slopes along x, along y, and along both, per cell.
    """
    both = weights_at(offset)
    weights = both[:, 1, :, None, :, None] * both[:, 0, None, :, None, :]
    found: Array = weights.reshape(len(offset), 4, 16) @ tables
    return found


def values_at(tables: Array, offset: Array) -> Array:
    """Interpolate tables as :func:`surfaces_at`, without slopes: (n, k)."""
    value = weights_at(offset)[:, :, 0]
    weights = value[:, 1, :, None] * value[:, 0, None, :]
    found: Array = (weights.reshape(len(offset), 1, 16) @ tables)[:, 0]
    return found


def stencils(node: Indices) -> Indices:
    """Nodes (rows · columns, 16) about the cell whose lower left corner each place is; −1 where one is missing."""
    padded = np.pad(node, ((1, 2), (1, 2)), constant_values=-1)
    rows, columns = node.shape
    parts = [padded[b : b + rows, a : a + columns] for b in range(4) for a in range(4)]
    return np.stack(parts, axis=-1).reshape(-1, 16)
