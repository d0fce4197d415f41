"""Interpolation between the nodes of a lattice: linear, and by cubic convolution (Keys 1981)."""

from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.calibration import ForceModel, Lattice

#: Weights of cubic convolution, and their slopes, as polynomials in the part of a cell.
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

#: Corners of a cell.
_DOWN: Final = np.array([0, 0, 1, 1])
_ACROSS: Final = np.array([0, 1, 0, 1])


def weights_at(part: Array) -> Array:
    """Weights of cubic convolution at parts (…) of a cell, and their slopes per cell: (…, 2, 4)."""
    powers = np.empty((*part.shape, 4))
    powers[..., 0], powers[..., 1] = 1.0, part
    np.multiply(part, part, out=powers[..., 2])
    np.multiply(powers[..., 2], part, out=powers[..., 3])
    weights: Array = powers @ _COEFFICIENTS
    return weights.reshape(*part.shape, 2, 4)


def surfaces_at(tables: Array, offset: Array) -> Array:
    """Interpolate tables (n, 16, k) at offsets (n, 2) in cells: value, slopes by x, y and both, (n, 4, k)."""
    both = weights_at(offset)
    weights = both[:, 1, :, None, :, None] * both[:, 0, None, :, None, :]
    return weights.reshape(len(offset), 4, 16) @ tables


def values_at(tables: Array, offset: Array) -> Array:
    """Interpolate tables as :func:`surfaces_at`, without slopes: (n, k)."""
    value = weights_at(offset)[:, :, 0]
    weights = value[:, 1, :, None] * value[:, 0, None, :]
    return (weights.reshape(len(offset), 1, 16) @ tables)[:, 0]


def stencils(node: Indices) -> Indices:
    """Nodes (rows · columns, 16) about the cell whose lower left corner each place is; −1 where one is missing."""
    padded = np.pad(node, ((1, 2), (1, 2)), constant_values=-1)
    rows, columns = node.shape
    parts = [padded[b : b + rows, a : a + columns] for b in range(4) for a in range(4)]
    return np.stack(parts, axis=-1).reshape(-1, 16)


def cells(lattice: Lattice, places_mm: Array) -> tuple[Indices, Array, Mask]:
    """Columns and rows (n, 2) of places' cells, offsets (n, 2) in them, and which places are on the lattice (n,)."""
    last_cell = np.array([lattice.columns - 2, lattice.rows - 2])
    position = (places_mm - np.array(lattice.origin_mm)) / lattice.spacing_mm
    inside_mask = np.logical_and.reduce((position >= 0) & (position <= last_cell + 1), axis=1)  # false for NaN
    position = np.where(inside_mask[:, None], position, 0.0)
    cell = np.minimum(position.astype(np.int64), last_cell)
    return cell, position - cell, inside_mask


def interpolate(model: ForceModel, values: Array, places_mm: Array) -> Array:
    """Values (n, …) of quantities (nodes, …) at places (n, 2), linear between nodes; NaN if a node is missing."""
    cell, offset, inside_mask = cells(model.lattice, places_mm)
    part = np.stack([1 - offset, offset], axis=2)
    weights = (part[:, 1, :, None] * part[:, 0, None, :]).reshape(len(cell), 1, 4)
    node = model.node[cell[:, 1, None] + _DOWN, cell[:, 0, None] + _ACROSS]
    missing_mask = ~inside_mask | np.logical_or.reduce((node < 0) & (weights[:, 0] != 0), axis=1)
    values_there: Array = (weights @ values.reshape(len(values), -1)[node])[:, 0]
    values_there[missing_mask] = np.nan
    return values_there.reshape(len(cell), *values.shape[1:])
