"""GREIT's imaging matrix for a λ, and the λ for a noise figure; recent matrices are cached.

A regularised image is shifted towards places of strong readings, and wider where they are weak. A scale of each row
and the width of its desired image correct both, so that masked images lie at their targets.
"""

from collections import OrderedDict
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Final

import numpy as np
from scipy import sparse
from scipy.optimize import brentq
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.inverse.greit.greit import WIDTHS, GreitRows, combine_widths
from cbsr_qa.eit.inverse.greit.targets import TargetDesign, neighbours, node_areas_mm2

_ROUNDS: Final = 10  # iterations: offsets are then 0.02 mm on the 100 mm disc, down from 0.4 mm
_MASK_POWER: Final = 10  # exponent of values; of 8 to 18 its centres are closest to those of an 85 % mask
_INNER: Final = 2.0  # radii of the head between a target and the sheet's edge: closer, images are cut off
_SEEN: Final = 2.5  # radii of the head around a target that may contain its mask
_SMOOTH: Final = 0.6  # radii of the head over which widths are averaged


class Calibration:
    """Shapes the rows of one problem; unchanged if every target is too close to the sheet's edge."""

    def __init__(self, fits: GreitRows) -> None:
        self._fits = fits
        targets, mesh, head_mm = fits.targets, fits.problem.mesh, fits.design.head_mm
        edge_mm = mesh.nodes_mm[np.unique(mesh.outline)]
        clear = _INNER * head_mm
        inner = targets.of_head & (_nearest(edge_mm, targets.centres_mm)[0] > clear)
        self._signals, centres = targets.signals[:, inner], targets.centres_mm[inner]
        self._any = bool(inner.any())
        if self._any:
            self._slopes = _SlopeFit(mesh)
            self._masks = _SoftMasks(mesh, centres, _SEEN * head_mm)
            self._beyond = _nearest(edge_mm, mesh.nodes_mm)[0] <= clear
            self._place = _nearest(centres, mesh.nodes_mm)[1]
            self._node = _nearest(mesh.nodes_mm, centres)[1]
            self._average = _averaging(mesh.nodes_mm, centres, _SMOOTH * head_mm)

    def rows(self, hyperparameter: float) -> Array:
        """Rows (n, g) of a λ, each with a scale and a width of its image; NumericsError where λ is too small.

        For a masked image displaced by b, the logarithm of the scale gets the slope −b/s, with s the second moment of
        the image; one scale is fitted to the slopes at all places by least squares. Its mean makes peaks equal those
        of the desired images.
        """
        solved = self._fits.solve(hyperparameter)  # for all widths, (n, g, w)
        variance, nodes = self._fits.design.head_variance_mm2, len(solved)
        scale, width = np.ones(nodes), np.ones(nodes)  # the second of the nominal second moment
        for _ in range(_ROUNDS if self._any else 0):
            images = scale[:, None] * combine_widths(solved, width) @ self._signals
            offset, spread = self._masks.moments(images)
            slope = np.where(self._beyond[:, None], 0.0, -offset[self._place] / variance)
            scale = scale * np.exp(self._slopes.fit(slope))
            scale = scale / (2 * np.pi * variance * float(np.median(images.max(axis=0))))
            width = np.clip(self._average @ (width[self._node] * variance / spread), WIDTHS[0], WIDTHS[-1])
        return scale[:, None] * combine_widths(solved, width)


class _SoftMasks:
    """Centre and spread of masked images, without the jumps of a mask, within a reach of each target (t, 2)."""

    def __init__(self, mesh: Mesh, centres_mm: Array, reach_mm: float) -> None:
        near = neighbours(mesh.nodes_mm, centres_mm, reach_mm)
        most_nodes = max(len(nodes) for nodes in near)
        self._node = np.array([np.pad(nodes, (0, most_nodes - len(nodes))) for nodes in near])
        is_node = np.arange(most_nodes) < np.array([len(nodes) for nodes in near])[:, None]
        self._mass = np.where(is_node, node_areas_mm2(mesh)[self._node], 0.0)  # (t, most)
        self._away = mesh.nodes_mm[self._node] - centres_mm[:, None]
        self._square = (self._away**2).sum(axis=2)
        self._smallest = float(mesh.areas_mm2.mean())  # a mask of one node has zero width

    def moments(self, images: Array) -> tuple[Array, Array]:
        """Offsets of masks of images (n, t) from their targets (t, 2) [mm], and second moments (t,) [mm²]."""
        positive = np.where(self._mass > 0, images.T[np.arange(len(self._node))[:, None], self._node], 0.0)
        relative = np.maximum(positive, 0) / np.maximum(positive.max(axis=1), np.finfo(float).tiny)[:, None]
        weight = relative**_MASK_POWER * self._mass
        weight /= np.maximum(weight.sum(axis=1), np.finfo(float).tiny)[:, None]
        offset = np.einsum("tk,tkd->td", weight, self._away)
        square = (weight * self._square).sum(axis=1) - (offset**2).sum(axis=1)
        return offset, np.maximum(_MASK_POWER * square / 2, self._smallest)


class _SlopeFit:
    """Piecewise linear function on a mesh, fitted to given slopes."""

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        side = np.roll(mesh.corners_mm, -2, axis=1) - np.roll(mesh.corners_mm, -1, axis=1)
        #: gradients of the hat functions times the element's area, (e, 3, 2)
        self._gradient = np.stack([-side[..., 1], side[..., 0]], axis=2) / 2
        local = np.einsum("eid,ejd->eij", self._gradient, self._gradient) / mesh.areas_mm2[:, None, None]
        row, column = (np.broadcast_to(mesh.elements[index], local.shape).ravel() for index in _PAIRS)
        count = len(mesh.nodes_mm)
        stiffness = sparse.csc_array((local.ravel(), (row, column)), shape=(count, count))
        # Slopes leave the mean free; any choice will do.
        self._factors = splu((stiffness + 1e-9 * sparse.diags_array(node_areas_mm2(mesh))).tocsc())

    def fit(self, slopes: Array) -> Array:
        """Values (n,) for slopes at the nodes (n, 2)."""
        mean = slopes[self._mesh.elements].mean(axis=1)
        source = np.einsum("eid,ed->ei", self._gradient, mean)
        values = self._factors.solve(np.bincount(self._mesh.elements.ravel(), source.ravel()))
        return np.asarray(values - values.mean(), dtype=np.float64)


def _nearest(points_mm: Array, places_mm: Array) -> tuple[Array, Indices]:
    """Distance of each place from the nearest of the points, and the index of that point."""
    away, nearest = cKDTree(points_mm).query(places_mm)
    return np.asarray(away, dtype=np.float64), np.asarray(nearest, dtype=np.int64)


def _averaging(nodes_mm: Array, places_mm: Array, length_mm: float) -> Array:
    """Matrix (n, t) that averages values at places around each node with a Gaussian of given length."""
    square = ((nodes_mm[:, None] - places_mm) ** 2).sum(axis=2)
    weight = np.exp(-(square - square.min(axis=1, keepdims=True)) / (2 * length_mm**2))
    averaging: Array = weight / weight.sum(axis=1, keepdims=True)
    return averaging


_PAIRS: Final = (np.s_[:, :, None], np.s_[:, None, :])


_LOWEST, _HIGHEST = (
    1e-4,
    0.6,
)  # λ searched, noise over signal of a reading: above, masks miss their targets
_TYPICAL: Final = (0.05, 0.3)  # searched first
_WIDER: Final = 4.0  # factor if the noise figure is not between them
_REACHED: Final = 1e-3  # in ln λ; half of that or less in the noise figure
_KEPT: Final = 6  # problems
_MATRICES: Final = 2  # per problem, 3.4 MB on the usual mesh


@dataclass(frozen=True, eq=False)
class GreitMatrix:
    """GREIT's matrix for one λ.

    Parameters
    ----------
    values : (e, m) float64, read only.
    noise_figure : Adler et al. 2009, with equal noise on all readings.
    """

    values: Array
    noise_figure: float


def greit_matrix(problem: ImagingProblem, design: TargetDesign, hyperparameter: float) -> GreitMatrix:
    """Make the imaging matrix of a λ, rms noise over rms signal of a reading.

    NumericsError if λ is negative, not finite, or too small to determine the image, or a target affects no reading.
    """
    results = _recall_results(problem, design)
    return results.matrices.get(hyperparameter) or _Search(problem, design, results).find_matrix(hyperparameter)


@dataclass(frozen=True, eq=False)
class GreitChoice:
    """The λ for a noise figure, with the search steps; independent of earlier searches.

    Parameters
    ----------
    value : λ.
    searched, noise_figures : (k,) float64, λ rising and the noise figure of each; ``value`` is among them.
    """

    value: float
    searched: Array
    noise_figures: Array


def hyperparameter_for(problem: ImagingProblem, design: TargetDesign, noise_figure: float) -> GreitChoice:
    """Find the λ whose matrix has a noise figure, to 1 in 1000; NumericsError names the range otherwise."""
    results = _recall_results(problem, design)
    if noise_figure not in results.chosen:
        results.chosen[noise_figure] = _Search(problem, design, results).for_noise_figure(noise_figure)
    return results.chosen[noise_figure]


@dataclass(frozen=True, eq=False)
class _Kept:
    matrices: OrderedDict[float, GreitMatrix] = field(default_factory=OrderedDict)
    chosen: dict[float, GreitChoice] = field(default_factory=dict)


_PROBLEMS: Final[OrderedDict[tuple[bytes, TargetDesign], _Kept]] = OrderedDict()


def _recall_results(problem: ImagingProblem, design: TargetDesign) -> _Kept:
    """Cached results for problems with the same numbers."""
    variance = problem.noise_variance
    digest = blake2b(problem.used.tobytes())
    for values in (problem.mesh.nodes_mm, problem.jacobian, problem.reference):
        digest.update(np.ascontiguousarray(values).tobytes())
    digest.update(b"" if variance is None else variance.tobytes())
    key = digest.digest(), design
    results = _PROBLEMS.setdefault(key, _Kept())
    _PROBLEMS.move_to_end(key)
    while len(_PROBLEMS) > _KEPT:
        _PROBLEMS.popitem(last=False)
    return results


class _Search:
    def __init__(self, problem: ImagingProblem, design: TargetDesign, kept: _Kept) -> None:
        self._fits, self._kept = GreitRows(problem, design), kept
        self._calibration = Calibration(self._fits)
        self._seen: dict[float, float] = {}

    def find_matrix(self, hyperparameter: float) -> GreitMatrix:
        matrices = self._kept.matrices
        if hyperparameter not in matrices:
            values = self._fits.matrix(self._calibration.rows(hyperparameter))
            values.flags.writeable = False  # shared by all callers
            matrices[hyperparameter] = GreitMatrix(values, self._fits.noise_figure(values))
            while len(matrices) > _MATRICES:
                matrices.popitem(last=False)
        matrices.move_to_end(hyperparameter)
        return matrices[hyperparameter]

    def for_noise_figure(self, target: float) -> GreitChoice:
        self._seen = {}
        ends = self._ends(target) if np.isfinite(target) and target > 0 else None
        if ends is None:
            reached_figures = [self._figure(value) for value in (_HIGHEST, _LOWEST)]
            raise NumericsError(
                f"noise figure {target} cannot be reached by greit; this problem allows"
                f" {reached_figures[0]:.3g} to {reached_figures[1]:.3g}",
                remedy="give a noise figure in that range, or the hyperparameter itself",
            )

        low, high = (float(np.log(end)) for end in ends)
        exactly = dict(zip((low, high), ends, strict=True))  # e^(ln λ) differs from λ in the last digit: fit again

        def over(at: float) -> float:
            return float(np.log(self._figure(exactly.get(at, float(np.exp(at)))) / target))

        root = float(brentq(over, low, high, xtol=_REACHED))
        value = exactly.get(root, float(np.exp(root)))
        self._seen[value] = self.find_matrix(value).noise_figure  # and its matrix is cached
        searched = np.array(sorted(self._seen))
        return GreitChoice(value, searched, np.array([self._seen[hyperparameter] for hyperparameter in searched]))

    def _figure(self, hyperparameter: float) -> float:
        """Noise figure of a λ, cached for the search."""
        if hyperparameter not in self._seen:
            self._seen[hyperparameter] = self.find_matrix(hyperparameter).noise_figure
        return self._seen[hyperparameter]

    def _ends(self, target: float) -> tuple[float, float] | None:
        """Two λ whose noise figures bracket the target, or None."""
        low, high = _TYPICAL
        while self._figure(low) < target:
            if low == _LOWEST:
                return None
            low = max(low / _WIDER, _LOWEST)
        if self._figure(high) > target:
            high = _HIGHEST
        return (low, high) if self._figure(high) <= target else None
