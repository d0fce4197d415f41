"""GREIT: the matrix that maps readings of training targets to desired images.

Each row of the matrix, one for each node of the image, is a separate least-squares fit (Adler et al. 2009, eq. 5):
min Σ_k W_k(x) [r(x)·y_k − d_k(x)]² + λ² |r(x)|², where W has full weight near the target and little elsewhere, since
the top of an image determines place and outline of a masked blob.
"""

from contextlib import suppress
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.eit.inverse.dual import check_hyperparameter
from cbsr_qa.eit.inverse.greit.targets import TargetDesign, Targets, make_targets, neighbours
from cbsr_qa.eit.inverse.noise_figures import central_signal, noise_figure
from cbsr_qa.eit.inverse.readings import ReadingFold

_NEAR: Final = 2.0  # radii of the head: errors of the image have weight up to here, most on top of the target
_FAR_WEIGHT: Final = 0.1  # weight of errors further out, relative to one on top
_LOUD: Final = 0.6  # of a peak: rows that respond more to a target further away give it more weight,
_RAISED: Final = 4.0  # by this factor of the squared error,
_RAISES: Final = 4  # at most so many times
_USUAL: Final = 0.1  # λ at which that is decided
_MAX_CONDITION: Final = 1e12  # of a row's normal equations; they have four digits then
_AT_ONCE: Final = 256  # rows solved together

#: Widths (second moments) of desired images that are solved for, relative to the nominal one; others are
#: interpolated.
WIDTHS: Final = (0.35, 0.55, 0.8, 1.1)


class GreitRows:
    """Least-squares fits of all rows on one problem.

    Parameters
    ----------
    problem : n image nodes, m readings, folded to g.
    design : design of the targets.
    """

    def __init__(self, problem: ImagingProblem, design: TargetDesign) -> None:
        self.problem = problem
        self.design = design
        self._fold = ReadingFold.from_problem(problem)
        self.targets = make_targets(problem, self._fold, design)
        self._signal = central_signal(problem)
        self._unit = float((self.targets.signals**2).mean())
        self._fit = _Fit(self.targets, _NEAR * design.head_mm)
        self._quieten()

    def solve(self, hyperparameter: float) -> Array:
        """Rows of the nodes, for folded readings of unit variance and each of :data:`WIDTHS`: (n, g, w).

        λ is rms noise over rms signal of a reading. NumericsError if it is negative, not finite, or does not
        determine the fit.
        """
        check_hyperparameter(hyperparameter)
        ridge = hyperparameter**2 * self._unit
        largest = float(np.einsum("ngg->n", self._fit.normal).max())  # at least the largest eigenvalue
        least, rows = float(np.sqrt(largest / _MAX_CONDITION / self._unit)), None
        if ridge * _MAX_CONDITION > largest:
            rows = self._solve_rows(hyperparameter, np.arange(len(self._fit.right)))
        if rows is None or not np.isfinite(rows).all():
            raise NumericsError(
                f"greit: hyperparameter {hyperparameter:.3g} is too small: the targets do not determine the image",
                remedy=f"give a hyperparameter above {least:.1e}, or give a noise figure",
            )
        return rows

    def _solve_rows(self, hyperparameter: float, nodes: Indices) -> Array:
        """Rows of some nodes, (k, g, w); not finite where λ is too small."""
        normal, right = self._fit.normal, self._fit.right
        ridge = hyperparameter**2 * self._unit * np.eye(normal.shape[1])
        rows = np.full((len(nodes), *right.shape[1:]), np.nan)
        for begin in range(0, len(nodes), _AT_ONCE):
            chunk = nodes[begin : begin + _AT_ONCE]
            with suppress(np.linalg.LinAlgError):
                rows[begin : begin + _AT_ONCE] = np.linalg.solve(normal[chunk] + ridge, right[chunk])
        return rows

    def _quieten(self) -> None:
        """Give errors further out more weight in rows that would respond strongly to far targets (near the edge)."""
        nodes = np.arange(len(self._fit.right))
        for _ in range(_RAISES):
            nodes = nodes[self._loudest(nodes) > _LOUD]
            if not nodes.size:
                return
            self._fit.raise_far(nodes)

    def _loudest(self, nodes: Indices) -> Array:
        """Largest error of some rows at targets further away that lie fully on the sheet, of a peak: (k,)."""
        targets, head_mm = self.targets, self.design.head_mm
        mesh = targets.mesh
        edge = cKDTree(mesh.nodes_mm[np.unique(mesh.outline)])
        full_targets = np.flatnonzero(targets.of_head & (np.asarray(edge.query(targets.centres_mm)[0]) >= head_mm))
        rows = combine_widths(self._solve_rows(_USUAL, nodes), np.ones(len(nodes)))
        error = np.abs(
            rows @ targets.signals[:, full_targets]
            - targets.target_images(mesh.nodes_mm[nodes], targets=full_targets)
        )
        offsets_mm = mesh.nodes_mm[nodes][:, None] - targets.centres_mm[full_targets]
        is_far = (offsets_mm**2).sum(axis=2) > (_NEAR * head_mm) ** 2
        loudest: Array = np.where(is_far, error, 0).max(axis=1, initial=0) * 2 * np.pi * self.design.head_variance_mm2
        return loudest

    def matrix(self, rows: Array) -> Array:
        """Imaging matrix (e, m) from rows (n, g): values of elements are the means of their corners."""
        nodal = self._fold.unfold(rows / np.sqrt(self._fold.variance))
        elements = self.problem.mesh.elements
        return (nodal[elements[:, 0]] + nodal[elements[:, 1]] + nodal[elements[:, 2]]) / 3

    def noise_figure(self, matrix: Array) -> float:
        """Noise figure (Adler et al. 2009, equal noise on all readings, independent of their weights)."""
        return noise_figure(matrix, self._signal, self.problem.mesh.areas_mm2)


def combine_widths(solved: Array, width: Array) -> Array:
    """Rows (n, g) for a width of each node (n,), from rows for :data:`WIDTHS` (n, g, w): a cubic in log width."""
    log_width, log_widths = np.log(width), np.log(WIDTHS)
    basis = np.ones((len(width), len(log_widths)))
    for column, knot in enumerate(log_widths):
        for other_knot in np.delete(log_widths, column):
            basis[:, column] *= (log_width - other_knot) / (knot - other_knot)
    rows: Array = np.einsum("ngw,nw->ng", solved, basis)
    return rows


class _Fit:
    """Normal equations of all rows: (n, g, g) and (n, g, w). Far targets have little weight: one width suffices."""

    def __init__(self, targets: Targets, near_mm: float) -> None:
        signals, nodes = targets.signals, targets.mesh.nodes_mm
        count = len(signals)
        self.normal = np.empty((len(nodes), count, count))
        self.right = np.empty((len(nodes), count, len(WIDTHS)))
        self._far_normal = _FAR_WEIGHT**2 * (signals @ signals.T)
        self._far_right = np.empty((len(nodes), count))
        self._share = np.empty(len(nodes))  # weight of the far errors
        close = neighbours(targets.centres_mm, nodes, near_mm)
        for row, (node, near_targets) in enumerate(zip(nodes, close, strict=True)):
            distance = np.hypot(*(targets.centres_mm[near_targets] - node).T) / near_mm
            # Weight of an image error: 1 at the target, 0 from the distance 1 on, smooth.
            weight = (1 - np.minimum(distance, 1) ** 4) ** 2
            weighted_signals = signals[:, near_targets] * weight
            self._share[row] = 1 / (weight.sum() + _FAR_WEIGHT**2 * signals.shape[1])
            self._far_right[row] = _FAR_WEIGHT**2 * targets.target_images(node[None])[0] @ signals.T
            near_right = weighted_signals @ targets.target_images(node[None], WIDTHS, near_targets)[0]
            self.normal[row] = (weighted_signals @ signals[:, near_targets].T + self._far_normal) * self._share[row]
            self.right[row] = (near_right + self._far_right[row][:, None]) * self._share[row]
        self._raised = np.ones(len(nodes))

    def raise_far(self, nodes: Indices) -> None:
        """Increase the weight of far errors in the rows of some nodes."""
        added_weight = (_RAISED - 1) * self._raised[nodes] * self._share[nodes]
        self.normal[nodes] += added_weight[:, None, None] * self._far_normal
        self.right[nodes] += (added_weight[:, None] * self._far_right[nodes])[..., None]
        self._raised[nodes] *= _RAISED
