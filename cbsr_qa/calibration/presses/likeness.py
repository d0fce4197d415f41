"""Likeness of a press's readings to those of a modelled load at each place of the sheet."""

from copy import copy
from typing import Final

import numpy as np
from scipy.ndimage import distance_transform_edt

from cbsr_qa.calibration.place.modelled import (
    interpolate_most_alike,
    log_likelihood,
    log_likelihood_slopes,
    unit_rows,
)
from cbsr_qa.calibration.presses.weak_loads import STEP, ModelledSheet
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.readings.answering import AnsweringSide, compare_sides

#: Log likelihood of a press off the sheet.
_OFF_SHEET: Final = -1.0
#: Weights of nodes for a point between the inner two, as polynomials: of four nodes cubic (Keys 1981, a = -1/2); of
#: two without slopes at nodes, since ascents would end at an edge.
_CUBIC: Final = np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2
_SMOOTH: Final = np.array([[1.0, 0.0], [0.0, 0.0], [-3.0, 3.0], [2.0, -2.0]])
#: Orders of derivatives along both axes.
_ORDERS: Final = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


def answering_side(sheet: ModelledSheet, pairs: Indices, changes: Array) -> AnsweringSide:
    """Find whether readings of one modelled polarity hardly respond, as behind a rectifying front end.

    Parameters
    ----------
    sheet : modelled sheet.
    pairs : (m, 4) source, sink, plus and minus of the readings.
    changes : (n, m) changes of the readings by the presses, in any unit.
    """
    alive: Mask = np.any(changes != 0, axis=0)
    modelled = np.median(np.abs(sheet.lattice.readings(pairs)), axis=0)
    answer = np.median(np.abs(changes), axis=0) / np.maximum(modelled, np.finfo(np.float64).tiny)
    side = compare_sides(answer, sheet.solve_unloaded(pairs) > 0)
    return AnsweringSide(alive & side.answers, side.words)


def alikeness(changes: Array, templates: Array) -> Array:
    """Cosines of changes (n, m) and templates (…, m) where the shapes broadcast, both compressed: (…)."""
    cosines: Array = np.einsum("...m,...m->...", unit_rows(changes), unit_rows(templates))
    return cosines


class Likeness:
    """Log likelihoods of presses by place, on the sheet's lattice.

    Parameters
    ----------
    sheet : modelled sheet.
    pairs : (m, 4) source, sink, plus and minus of the readings.
    changes : (n, m) changes of the readings by presses, with the sign of a rise of conductance.
    """

    def __init__(self, sheet: ModelledSheet, pairs: Indices, changes: Array) -> None:
        lattice = sheet.lattice
        self._node, self._alike = lattice.node, unit_rows(changes) @ unit_rows(lattice.readings(pairs)).T
        self._centre = int(np.abs(self._node).max()) + 2  # two more than are on the sheet, for cubic interpolation
        self._width = 2 * self._centre + 1
        rows, columns = (self._node + self._centre).T
        self._on_sheet = np.zeros((self._width, self._width))
        self._on_sheet[rows, columns] = 1.0
        maps = np.zeros((len(changes), self._width, self._width))
        maps[:, rows, columns] = self._alike
        nearest = distance_transform_edt(self._on_sheet == 0, return_distances=False, return_indices=True)
        self._maps = np.ascontiguousarray(maps[:, *nearest])  # an index of arrays leaves presses last in memory
        self._rough = np.where(self._on_sheet > 0, log_likelihood(self._maps), _OFF_SHEET)

    def select(self, presses: Indices) -> "Likeness":
        """Likeness of some of the presses."""
        selected = copy(self)
        selected._maps, selected._alike = self._maps[presses], self._alike[presses]
        selected._rough = self._rough[presses]
        return selected

    def approximate(self, places: Array) -> Array:
        """Log likelihood of each press, linear between nodes: a fifth of the work, to choose where to begin."""
        (x, y), first = self._locate_in_grid(places)
        flat, width = self._rough.ravel(), self._width
        near = (1 - y) * flat.take(first) + y * flat.take(first + 1)
        far = (1 - y) * flat.take(first + width) + y * flat.take(first + width + 1)
        value: Array = (1 - x) * near + x * far
        return value

    def evaluate(self, places: Array) -> Array:
        """Log likelihood of each press at its place (…, n, 2) in radii, with its derivatives: (6, …, n).

        These are the value, the slopes along x and y, and the second derivatives by xx, xy and yy. Cosines are cubic
        between nodes: interpolated linearly, likelihoods would be largest at nodes, and presses on a grid would be
        found on one of the lattice, however far apart they are. Beyond the sheet likelihoods fade over one node.
        """
        cell_offset, node = self._locate_in_grid(places)
        correlation, x, y, xx, xy, yy = self._interpolate(self._maps, cell_offset, node - self._width - 1, _CUBIC)
        sheet, sheet_x, sheet_y, sheet_xx, sheet_xy, sheet_yy = self._interpolate(
            self._on_sheet, cell_offset, node % self._width**2, _SMOOTH
        )
        log_ratio = log_likelihood(correlation) - _OFF_SHEET
        slope, curvature = log_likelihood_slopes(correlation)
        return np.stack(
            [
                sheet * log_ratio + _OFF_SHEET,
                sheet_x * log_ratio + sheet * slope * x,
                sheet_y * log_ratio + sheet * slope * y,
                sheet_xx * log_ratio + slope * (2 * sheet_x * x + sheet * xx) + sheet * curvature * x**2,
                sheet_xy * log_ratio + slope * (sheet_x * y + sheet_y * x + sheet * xy) + sheet * curvature * x * y,
                sheet_yy * log_ratio + slope * (2 * sheet_y * y + sheet * yy) + sheet * curvature * y**2,
            ]
        )

    def _interpolate(self, maps: Array, between: Array, first: Indices, polynomials: Array) -> Array:
        """Value (…) between nodes and its derivatives (6, …) per radius, in the order of :meth:`evaluate`.

        Parameters
        ----------
        between : (2, …) offset of the point from a node, in steps.
        first : (…) the number of the first node of a square that counts.
        polynomials : (p, k) coefficients of the powers of that distance, for the weight of each of the k nodes.
        """
        flat, nodes = maps.ravel(), polynomials.shape[1]
        along, across = (_weights(t, polynomials) for t in between)
        derivatives = np.zeros((len(_ORDERS), *first.shape))
        for m in range(nodes):
            row = [flat.take(first + (m * self._width + n)) for n in range(nodes)]
            lines = [sum(w * values for w, values in zip(weights, row, strict=True)) for weights in across]
            for k, (i, j) in enumerate(_ORDERS):
                derivatives[k] += along[i][m] * lines[j]
        for k, (i, j) in enumerate(_ORDERS):
            derivatives[k] /= STEP ** (i + j)
        return derivatives

    def _locate_in_grid(self, places: Array) -> tuple[Array, Indices]:
        """Offsets (2, …, n) of places (…, n, 2) from a node, and the number of that node in all maps (…, n)."""
        position = np.clip(places / STEP + self._centre, 1.0, self._width - 2.001)
        node = position.astype(np.int64)
        press = np.arange(len(self._maps))
        return np.moveaxis(position - node, -1, 0), (press * self._width + node[..., 0]) * self._width + node[..., 1]

    def best_places(self) -> Array:
        """Most likely place (n, 2) of each press, in radii, interpolated by parabolas."""
        return STEP * interpolate_most_alike(self._node, self._alike)


def _weights(t: Array, polynomials: Array) -> Array:
    """Weights of nodes and their first two derivatives (3, k, …) at t (…)."""
    order = np.arange(1, len(polynomials))[:, None]
    first = np.vstack([order * polynomials[1:], np.zeros_like(polynomials[:1])])
    second = np.vstack([order * first[1:], np.zeros_like(first[:1])])
    powers = t.ravel() ** np.arange(len(polynomials))[:, None]
    weights: Array = np.stack([polynomials, first, second]).swapaxes(1, 2) @ powers
    return weights.reshape(3, -1, *t.shape)
