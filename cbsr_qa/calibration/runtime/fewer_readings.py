"""A force model for frames in which some readings say nothing, or an offset is added to all. Numpy alone.

Rows of merged readings keep what their other readings say, with the noise of those; rows without any are taken away.
In frames with an offset, only the part that no offset explains is compared. In both cases templates, and with them
the errors of place and strength, become those of the remaining part.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from cbsr_qa.domain.goodness import deviates_from_model
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.calibration import ForceModel

#: Fewest rows that determine a place.
FEWEST_ROWS: Final = 12
#: Least share of the residual of a head, or of none, beyond noise that an offset on all readings explains, and its
#: least amount in squares of noise.
BY_OFFSET: Final = 0.95
LEAST_OFFSET: Final = 50.0


def reading_noise(merging: Array) -> Array:
    """Standard deviation (m,) of readings merged into rows (r, m) of unit noise: precision pᵢ enters as pᵢ/√Σp."""
    weight = np.abs(merging)
    precision = (weight * weight.sum(axis=1, keepdims=True)).sum(axis=0)
    noise: Array = 1 / np.sqrt(np.maximum(precision, np.finfo(np.float64).tiny))
    return noise


def drop_readings(model: ForceModel, kept: Mask) -> ForceModel:
    """Return the model of frames with fewer readings: ``kept`` (m,) bool of its own."""
    weight = np.abs(model.merging)
    precision = weight.sum(axis=1)  # the root of a row's precision
    remaining_root = np.sqrt((weight * kept).sum(axis=1) / precision)
    rows = remaining_root > 0
    merging = model.merging[rows][:, kept] / remaining_root[rows, None]
    return _with_rows(
        model,
        merging,
        model.templates[:, rows] * remaining_root[rows],
        model.size_slope[:, rows] * remaining_root[rows],
    )


def ignore_offset(model: ForceModel) -> ForceModel:
    """Return the model of frames with an unknown offset on all readings."""
    unit_row = offset_row(model)
    merging = model.merging - np.outer(unit_row, unit_row @ model.merging)
    templates, size_slope = (
        rows - np.outer(rows @ unit_row, unit_row) for rows in (model.templates, model.size_slope)
    )
    return _with_rows(model, merging, templates, size_slope)


def offset_row(model: ForceModel) -> Array:
    """Rows (r,) of one offset on all readings, of unit length."""
    offset = model.merging.sum(axis=1)
    row: Array = offset / np.linalg.norm(offset)
    return row


def offset_between(model: ForceModel, difference: Array) -> Mask:
    """Whether differences (n, m) of two frames each are one offset on all readings, and little else."""
    rows = difference @ model.merging.T / np.sqrt(2)
    size = (rows @ offset_row(model)) ** 2
    residual_square = (rows**2).sum(axis=1) - size
    offset_mask: Mask = (size > LEAST_OFFSET) & ~deviates_from_model(
        size, residual_square, rows.shape[1], 1 - BY_OFFSET
    )
    return offset_mask


def _with_rows(model: ForceModel, merging: Array, templates: Array, size_slope: Array) -> ForceModel:
    length = np.linalg.norm(templates, axis=1)
    unit = templates / length[:, None]
    slopes, inner_mask = lattice_slopes(model.node, unit, model.lattice.spacing_mm)
    turns = np.stack([(slopes[:, a] * slopes[:, b]).sum(axis=1) for a, b in ((0, 0), (0, 1), (1, 1))], axis=1)
    growth, _ = lattice_slopes(model.node, np.log(length)[:, None], model.lattice.spacing_mm)
    return replace(
        model,
        merging=merging,
        templates=unit,
        log_size=model.log_size + np.log(length),
        size_slope=size_slope / length[:, None],
        log_size_gradient=model.log_size_gradient + growth[:, :, 0],
        turning=np.where(inner_mask[:, None], turns, model.turning),
    )


def lattice_slopes(node: Indices, values: Array, spacing_mm: float) -> tuple[Array, Mask]:
    """Slopes (nodes, 2, k) along x and y of values (nodes, k) [1/mm], and at which nodes both have a neighbour."""
    padded = np.pad(node, 1, constant_values=-1)
    row, column = np.nonzero(node >= 0)
    node_index = padded[row + 1, column + 1]
    slopes, neighbour_mask = np.zeros((len(values), 2, values.shape[1])), np.ones(len(values), dtype=np.bool_)
    for axis, (down, across) in enumerate(((0, 1), (1, 0))):
        ahead, behind = padded[row + 1 + down, column + 1 + across], padded[row + 1 - down, column + 1 - across]
        steps = (ahead >= 0).astype(np.float64) + (behind >= 0)
        difference = (
            values[np.where(ahead >= 0, ahead, node_index)] - values[np.where(behind >= 0, behind, node_index)]
        )
        slopes[node_index, axis] = difference / (np.maximum(steps, 1) * spacing_mm)[:, None]
        neighbour_mask[node_index] &= steps > 0
    return slopes, neighbour_mask
