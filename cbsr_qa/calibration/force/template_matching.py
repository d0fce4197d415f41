"""Frames compared with the bank of templates: strength and place of a head, with their errors.

Numpy alone, for use in robots. Between the nodes of the lattice everything is interpolated by cubic convolution (Keys
1981). With t(p) the template of place p and y a frame's rows of unit noise, b = t·y and g = t·t, the strength at a
known place is a = b/g with variance 1/g; the most likely place is where b²/g is largest, found on the lattice and
from there by Fisher scoring.
"""

from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.force.interpolation import cells, stencils, surfaces_at, values_at, weights_at
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.calibration import ForceModel

_STEPS: Final = 4  # steps of Fisher scoring; the last is below 0.01 mm
_FURTHEST: Final = 0.25  # cells that scoring may move beyond its cell
_NOTHING: Final = 1e-30  # least squared score: a frame without change has no place
_MOVES: Final = 4  # moves to a neighbouring cell
_STRIDE: Final = 2  # nodes between the searched ones
_AT_ONCE: Final = 512  # frames compared with the bank together, so that data stay in the processor's cache


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """One head in each of n frames.

    Parameters
    ----------
    place_mm : (n, 2) places; NaN without nodes around it.
    strength : (n,) a = 2κ/(2 + κ).
    covariance : (n, 3, 3) covariance of (strength, x, y); zero for a given place.
    gain : (n,) b²/g, decrease of the squared residuals by the head.
    energy : (n,) y·y.
    """

    place_mm: Array
    strength: Array
    covariance: Array
    gain: Array
    energy: Array


class TemplateFilter:
    """Compares frames with the templates of a force model.

    CalibrationError if no place has the neighbours needed for a search.

    Parameters
    ----------
    model : force model of the sensor.
    size : q, the head's squared radius over that of the calibrated one.

    Attributes
    ----------
    threshold : detectability of a load.
    bank, searched_mm : (r, k) templates of unit length at the places (k, 2) that are searched.
    """

    def __init__(self, model: ForceModel, *, size: float = 1.0) -> None:
        self.lattice = model.lattice
        self.threshold = model.threshold
        grown = model.templates + (size - 1) * model.size_slope
        length = np.linalg.norm(grown, axis=1)
        self.templates: Array = np.ascontiguousarray(grown / length[:, None])
        self._tables = np.column_stack([model.log_size + np.log(length), model.log_size_gradient, model.turning])
        self._stencil = stencils(model.node)
        self._whole: Mask = np.logical_and.reduce(self._stencil >= 0, axis=1)
        self._node_of = model.node.ravel()
        fits_mask = np.where(model.node >= 0, model.fits[model.node], False).ravel()
        rows, columns = (np.abs(np.arange(count) - count // 2) % _STRIDE == 0 for count in model.node.shape)
        # A head fits on each of these places, and each has the neighbours for interpolation.
        self._coarse = np.flatnonzero(self._whole & fits_mask & np.logical_and.outer(rows, columns).ravel())
        if not len(self._coarse):
            raise CalibrationError(
                "there is no place on the lattice that a head could be searched from",
                remedy="press with a smaller head, or a larger sheet",
            )
        self.bank: Array = np.ascontiguousarray(self.templates[self._node_of[self._coarse]].T)
        self.searched_mm: Array = model.lattice.places_mm()[self._coarse]
        number = np.full(model.node.size, -1)
        number[self._coarse] = np.arange(len(self._coarse))
        steps = np.array([-1, 1, -model.lattice.columns, model.lattice.columns])
        self._next = number[self._coarse[:, None] + _STRIDE * steps]  # before and after, along x and along y

    def match_at(self, rows: Array, place_mm: Array) -> Matches:
        """Strength of a head at given places: (n, r) rows, places (2,) or (n, 2)."""
        given_mm = np.asarray(place_mm, dtype=np.float64)
        places = np.broadcast_to(given_mm, (len(rows), 2))
        template = self.template(given_mm[None] if given_mm.ndim == 1 else given_mm)
        number = rows @ template[0] if given_mm.ndim == 1 else (rows * template).sum(axis=1)
        gram = np.broadcast_to((template**2).sum(axis=1), len(rows))
        covariance = np.zeros((len(rows), 3, 3))
        covariance[:, 0, 0] = 1 / gram
        energy = np.einsum("nr,nr->n", rows, rows)
        return Matches(places.copy(), number / gram, covariance, number**2 / gram, energy)

    def template(self, places_mm: Array) -> Array:
        """Changes per strength (n, r) at places (n, 2); NaN without nodes around a place."""
        nodes, offset = self._cells(places_mm)
        value = weights_at(offset)[:, :, 0]
        weights = (value[:, 1, :, None] * value[:, 0, None, :]).reshape(len(nodes), 16)
        templates: Array = np.einsum("nk,nkr->nr", weights, self.templates[nodes])
        templates *= np.exp(np.einsum("nk,nk->n", weights, self._tables[nodes, 0]))[:, None]
        templates[(nodes < 0).any(axis=1)] = np.nan
        return templates

    def template_and_slopes(self, places_mm: Array) -> Array:
        """Changes per strength at places (n, 2) and slopes by x and y [1/mm], (n, 3, r); NaN without a node."""
        nodes, offset = self._cells(places_mm)
        ((value_x, slope_x), (value_y, slope_y)) = weights_at(offset).transpose(1, 2, 0, 3)
        h = self.lattice.spacing_mm
        pairs = ((value_y, value_x), (value_y, slope_x / h), (slope_y / h, value_x))
        weights = np.stack(
            [(down[:, :, None] * across[:, None, :]).reshape(-1, 16) for down, across in pairs], axis=1
        )
        templates: Array = weights @ self.templates[nodes]
        size = (weights @ self._tables[nodes, 0][:, :, None])[:, :, 0]
        templates[:, 1:] += templates[:, :1] * size[:, 1:, None]
        templates *= np.exp(size[:, 0])[:, None, None]
        templates[(nodes < 0).any(axis=1)] = np.nan
        return templates

    def size_slope(self, places_mm: Array) -> Array:
        """Slope (n, 2) of the logarithm of a change's size at places (n, 2) [1/mm]; 0 without nodes."""
        nodes, offset = self._cells(places_mm)
        slope = values_at(self._tables[nodes], offset)[:, 1:3]
        slope[np.logical_or.reduce(nodes < 0, axis=1)] = 0.0
        return slope

    def search(self, rows: Array) -> Matches:
        """Find one head in each of n frames (n, r)."""
        parts = [self._search(rows[first : first + _AT_ONCE]) for first in range(0, len(rows), _AT_ONCE)]
        if not parts:
            return Matches(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 3, 3)), np.zeros(0), np.zeros(0))
        return Matches(
            *(np.concatenate([getattr(part, column.name) for part in parts]) for column in fields(Matches))
        )

    def match_beside(self, rows: Array, place_mm: Array, strength: Array) -> tuple[Array, Array]:
        """Gain (n,) and strength (n,) of a second head besides the first in each frame, at the searched places."""
        gain, gain_strength = np.zeros(len(rows)), np.zeros(len(rows))
        for first in range(0, len(rows), _AT_ONCE):
            batch = slice(first, first + _AT_ONCE)
            first_template = np.nan_to_num(self.template(place_mm[batch]))
            score = (rows[batch] - strength[batch, None] * first_template) @ self.bank
            best = np.abs(score).argmax(axis=1)
            peak = score[np.arange(len(best)), best]
            gain[batch] = peak**2
            gain_strength[batch] = peak * np.exp(-self._tables[self._node_of[self._coarse[best]], 0])
        return gain, gain_strength

    def ambiguous(self, rows: Array, matches: Matches) -> Matches:
        """Matches whose covariance holds all other searched places too, each as likely as its readings are.

        Where few readings are left, places far from each other may explain a frame alike.
        """
        covariance = matches.covariance.copy()
        cell = (_STRIDE * self.lattice.spacing_mm) ** 2
        size = np.exp(self._tables[self._node_of[self._coarse], 0])
        for n, (row, place) in enumerate(zip(rows, matches.place_mm, strict=True)):
            score = row @ self.bank
            displacement_mm = self.searched_mm - place
            match_weight = 2 * np.pi * np.sqrt(max(float(np.linalg.det(covariance[n, 1:, 1:])), 0.0))
            far_mask = (displacement_mm**2).sum(axis=1) > 9 * np.trace(covariance[n, 1:, 1:]) + cell
            weight = cell * np.exp(np.minimum(score**2 - matches.gain[n], 0.0) / 2) * far_mask
            deviation = np.column_stack([score / size - matches.strength[n], displacement_mm])
            total = match_weight + weight.sum()
            if weight.any() and np.isfinite(total):
                covariance[n] += (deviation.T * weight) @ deviation / total
        return replace(matches, covariance=covariance)

    def _search(self, rows: Array) -> Matches:
        cell, offset = self._cell_of_best(rows @ self.bank)
        offset, surfaces = self._maximise_score(self._read_surroundings(cell, rows), offset)
        for _ in range(_MOVES):
            moved_mask, aim = self._neighbours(cell, offset)
            if not moved_mask.any():
                break
            cell[moved_mask] = aim[moved_mask]
            offset[moved_mask], surfaces[moved_mask] = self._maximise_score(
                self._read_surroundings(cell[moved_mask], rows[moved_mask]), np.full((int(moved_mask.sum()), 2), 0.5)
            )
        strength, covariance, gain = self._read_result(surfaces)
        j, i = np.divmod(cell, self.lattice.columns)
        h = self.lattice.spacing_mm
        place = np.empty((len(cell), 2))
        place[:, 0] = self.lattice.origin_mm[0] + h * (i + offset[:, 0])
        place[:, 1] = self.lattice.origin_mm[1] + h * (j + offset[:, 1])
        return Matches(place, strength, covariance, gain, np.einsum("nr,nr->n", rows, rows))

    def _read_surroundings(self, cell: Indices, rows: Array) -> Array:
        nodes = self._stencil[cell]
        surroundings = np.empty((*nodes.shape, 7))
        surroundings[:, :, :1] = self.templates[nodes] @ rows[:, :, None]
        surroundings[:, :, 1:] = self._tables[nodes]
        return surroundings

    def _neighbours(self, cell: Indices, offset: Array) -> tuple[Mask, Indices]:
        """Mask of frames that should move to a neighbouring cell with interpolation, and that cell."""
        step: Indices = (offset >= 1 + _FURTHEST).astype(np.int64) - (offset <= -_FURTHEST)
        aim = cell + step[:, 0] + self.lattice.columns * step[:, 1]
        move_mask: Mask = step.any(axis=1) & self._whole[aim]
        return move_mask, aim

    def _cell_of_best(self, score: Array) -> tuple[Indices, Array]:
        """Lower left corner of the cell of each head, and the offset in it, by parabolas through neighbours."""
        score = np.abs(score)
        frames, best = np.arange(len(score)), score.argmax(axis=1)
        place, neighbour = self._coarse[best], self._next[best]
        around = np.where(neighbour >= 0, score[frames[:, None], neighbour], -np.inf)
        low, high, peak = around[:, ::2], around[:, 1::2], score[frames, best][:, None]
        finite_mask = np.isfinite(low + high)
        bend = np.where(finite_mask, 2 * peak - low - high, 1.0)
        fraction = np.where(finite_mask, (high - low) / np.maximum(2 * bend, _NOTHING), 0.0)
        shift = _STRIDE * np.minimum(np.maximum(fraction, -0.5), 0.5)
        corner = np.floor(shift).astype(np.int64)
        cell = place + corner[:, 0] + self.lattice.columns * corner[:, 1]
        whole_mask = self._whole[cell]
        return np.where(whole_mask, cell, place), np.where(whole_mask[:, None], shift - corner, 0.0)

    def _maximise_score(self, about: Array, offset: Array) -> tuple[Array, Array]:
        """Offset (n, 2) from the cell's corner, in cells, of the largest score, by Fisher scoring.

        A step that lowers the score is repeated with a quarter of the length: beside a pin templates vary too
        unevenly for full steps.

        Returns
        -------
        The offset, and values and slopes per cell of score and tables there (n, 4, 7).
        """
        surfaces, squared = surfaces_at(about, offset), self.lattice.spacing_mm**2
        damping = np.ones(len(about))
        for _ in range(_STEPS):
            aim = offset + _scoring_step(surfaces, damping / squared)
            aim = np.minimum(np.maximum(aim, -_FURTHEST), 1 + _FURTHEST)
            aim_surfaces = surfaces_at(about, aim)
            better_mask = np.abs(aim_surfaces[:, 0, 0]) > np.abs(surfaces[:, 0, 0])
            if better_mask.all():
                offset, surfaces, damping = aim, aim_surfaces, np.ones(len(about))
                continue
            offset, surfaces = (
                np.where(better_mask[:, None], aim, offset),
                np.where(better_mask[:, None, None], aim_surfaces, surfaces),
            )
            damping = np.where(better_mask, 1.0, damping / 4)
        return offset, surfaces

    def _read_result(self, there: Array) -> tuple[Array, Array, Array]:
        score, log_size, *_, xx, xy, yy = there[:, 0].T
        strength, log_size_slope = score / np.exp(log_size), there[:, 0, 2:4]
        squared = np.maximum(score**2, _NOTHING)
        place = np.empty((len(there), 2, 2))
        place[:, 0, 0], place[:, 1, 1] = yy, xx
        place[:, 0, 1] = place[:, 1, 0] = -xy
        place /= ((xx * yy - xy**2) * squared)[:, None, None]
        place_slope = -(place @ log_size_slope[:, :, None])[:, :, 0]  # of ln strength
        covariance = np.empty((len(there), 3, 3))
        covariance[:, 0, 0] = strength**2 * (1 / squared - (place_slope * log_size_slope).sum(axis=1))
        covariance[:, 0, 1:] = covariance[:, 1:, 0] = strength[:, None] * place_slope
        covariance[:, 1:, 1:] = place
        return strength, covariance, score**2

    def _cells(self, places_mm: Array) -> tuple[Indices, Array]:
        """Nodes (n, 16) about places, and the places' offsets from the cells' corners, in cells."""
        cell, offset, inside_mask = cells(self.lattice, places_mm)
        nodes = self._stencil[cell[:, 1] * self.lattice.columns + cell[:, 0]].copy()
        nodes[np.logical_not(inside_mask)] = -1
        return nodes, offset


def _scoring_step(at: Array, damping: Array) -> Array:
    """Step (n, 2) of Fisher scoring in cells, at most half of one, from the values there (n, 4, 7)."""
    score, by_x, by_y = at[:, 0, 0], at[:, 1, 0], at[:, 2, 0]
    xx, xy, yy = at[:, 0, 4:].T
    steepness = score * (xx * yy - xy * xy)
    scale = np.divide(damping, steepness, out=np.zeros(len(at)), where=steepness != 0)
    step = np.empty((len(at), 2))
    step[:, 0] = (yy * by_x - xy * by_y) * scale
    step[:, 1] = (xx * by_y - xy * by_x) * scale
    return np.minimum(np.maximum(step, -0.5), 0.5)


def add_scatter(matches: Matches, size_slope: Array, scatter_mm: float) -> Matches:
    """Matches with additional scatter of found places beyond noise, and of their strengths.

    Parameters
    ----------
    size_slope : (n, 2) slopes at the places (:meth:`TemplateFilter.size_slope`): a head misplaced to where changes
        are larger seems correspondingly weaker.
    scatter_mm : standard deviation along an axis.
    """
    towards = np.empty((len(size_slope), 3, 2))
    towards[:, 0], towards[:, 1:] = -matches.strength[:, None] * size_slope, _ONES
    covariance = matches.covariance + scatter_mm**2 * (towards @ towards.transpose(0, 2, 1))
    return replace(matches, covariance=covariance)


_ONES: Final = np.eye(2)
