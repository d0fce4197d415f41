"""Training data of GREIT: round targets, their readings and their desired images."""

from dataclasses import dataclass
from functools import cached_property
from math import log
from typing import Any, Final, Self

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.polygons import circle_overlap_mm2
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.forward.elements import reaches_mm
from cbsr_qa.eit.inverse.noise_figures import target_radius_mm
from cbsr_qa.eit.inverse.readings import ReadingFold

#: Level, over the peak, at which the contour of a target's image equals its outline: the mask used to judge.
CONTOUR: Final = 0.85
_CLOSEST: Final = 0.35  # of the head's radius: closer targets add nothing
_RESOLVED: Final = 1.5  # edges of the image's elements per width of the head: below, its image is not Gaussian
_SMALLEST: Final = 0.1  # smallest target, of the head
_WIDEST: Final = 0.5  # largest target's radius, of the sheet's
_ALL: Final = slice(None)


@dataclass(frozen=True, slots=True)
class TargetDesign:
    """Sizes of the targets, and how their images are blurred.

    All images are the targets blurred by *one* Gaussian, so wide that the 85 % contour of the head's image is the
    head's outline.

    Parameters
    ----------
    head_mm : radius of the indenter.
    radii_mm : radii of all targets, rising; the head's is one of them.
    """

    head_mm: float
    radii_mm: tuple[float, ...]

    @classmethod
    def for_problem(
        cls, problem: ImagingProblem, head_diameter_mm: float | None, diameters_mm: tuple[float, ...] | None
    ) -> Self:
        """Fill in defaults: a head of 0.13 of the sheet's diameter; targets from 8/13 to 20/13 of it.

        Raises
        ------
        NumericsError
            If a size is not a positive number, a target is wider than half of the sheet or narrower than a tenth of
            the head, or the head narrower than 1.5 edges of the image's elements.
        """
        head = target_radius_mm(problem) if head_diameter_mm is None else head_diameter_mm / 2
        other_radii_mm = (head * 8 / 13, head * 20 / 13) if diameters_mm is None else (d / 2 for d in diameters_mm)
        radii = tuple(sorted({head, *other_radii_mm}))
        largest = _WIDEST * problem.sensor_type.radius_mm
        for radius in (head, *radii):
            if not 0 < radius <= largest:
                raise NumericsError(
                    f"greit: a target of diameter {2 * radius:.3g} mm does not fit on the sheet",
                    remedy=f"give diameters above 0 and up to {2 * largest:.3g} mm",
                )
        _check_resolved(problem.mesh, head, radii)
        return cls(head, radii)

    @property
    def head_variance_mm2(self) -> float:
        """Second moment, along one axis, of the head's image."""
        return self.head_mm**2 / (2 * log(1 / CONTOUR))

    def variance_mm2(self, radius_mm: float) -> float:
        """Second moment of the image of another target: a disc has r²/4, and blurring adds."""
        return self.head_variance_mm2 + (radius_mm**2 - self.head_mm**2) / 4


@dataclass(frozen=True, eq=False)
class Targets:
    """Targets all over a sheet, each of 1 mm² × contrast, with their readings.

    Parameters
    ----------
    mesh : mesh of the image, n nodes.
    centres_mm : (t, 2) float64.
    variance_mm2 : (t,) float64, second moment of each one's image.
    head_variance_mm2 : the same variance for a target of the head's size.
    of_head : (t,) bool, those of the head's own size.
    signals : (g, t) float64, folded readings of unit variance.
    """

    mesh: Mesh
    centres_mm: Array
    variance_mm2: Array
    head_variance_mm2: float
    of_head: Mask
    signals: Array

    @cached_property
    def _integral(self) -> Array:
        """Integral over the sheet of each desired image before it is scaled, (t,) [mm²]."""
        nodes, mass = self.mesh.nodes_mm, node_areas_mm2(self.mesh)
        places, number = np.unique(np.column_stack([self.centres_mm, self.variance_mm2]), axis=0, return_inverse=True)
        square = ((nodes[:, None] - places[None, :, :2]) ** 2).sum(axis=2)
        integral: Array = (mass @ np.exp(-square / (2 * places[:, 2])))[number.ravel()]
        return integral

    def target_images(
        self, places_mm: Array, widths: tuple[float, ...] = (1.0,), targets: Indices | slice = _ALL
    ) -> Array:
        """Images of some targets at places (k, 2): Gaussians, each with an integral of one over the sheet.

        Parameters
        ----------
        widths : w second moments of the head's image, relative to its nominal one; the peaks are unchanged.
        targets : t indices, all by default.

        Returns
        -------
        (k, t, w), or (k, t) for one width.
        """
        square = ((places_mm[:, None] - self.centres_mm[targets]) ** 2).sum(axis=2)
        further = (np.array(widths) - 1) * self.head_variance_mm2
        variance = self.variance_mm2[targets][:, None] + further
        images: Array = np.exp(-square[..., None] / (2 * variance)) / self._integral[targets][:, None]
        return images if len(widths) > 1 else images[..., 0]


def _check_resolved(mesh: Mesh, head_mm: float, radii_mm: tuple[float, ...]) -> None:
    """Refuse a head that the image's elements cannot resolve, and targets that are points compared with it."""
    edge_mm = float(np.sqrt(4 / np.sqrt(3) * mesh.areas_mm2.mean()))
    if 2 * head_mm < _RESOLVED * edge_mm:
        raise NumericsError(
            f"greit: a head of diameter {2 * head_mm:.3g} mm is not resolved by image elements of {edge_mm:.2g} mm",
            remedy=f"give a diameter of at least {_RESOLVED * edge_mm:.2g} mm, or image on smaller elements",
        )
    if radii_mm[0] < _SMALLEST * head_mm:
        raise NumericsError(
            f"greit: a target of diameter {2 * radii_mm[0]:.3g} mm is too small for a head of {2 * head_mm:.3g} mm",
            remedy=f"give diameters of at least {2 * _SMALLEST * head_mm:.3g} mm",
        )


def make_targets(problem: ImagingProblem, fold: ReadingFold, design: TargetDesign) -> Targets:
    """Make targets of every size all over the sheet, linear in contrast; NumericsError if no reading senses one."""
    mesh, nodes = problem.mesh, problem.mesh.nodes_mm
    centres = nodes[_thin_out(nodes, _CLOSEST * design.head_mm)]
    white = fold.rows(problem.jacobian) / np.sqrt(fold.variance)[:, None]
    signals_by_radius = [disc_signals(white, mesh, centres, radius) for radius in design.radii_mm]
    signals, count = np.hstack(signals_by_radius), len(centres)
    if not (signals != 0).any(axis=0).all():
        raise NumericsError("greit: no remaining reading responds to a target", remedy="repair the masked channels")
    radii = np.repeat(design.radii_mm, count)
    return Targets(
        mesh,
        np.tile(centres, (len(signals_by_radius), 1)),
        np.array([design.variance_mm2(radius) for radius in radii]),
        design.head_variance_mm2,
        radii == design.head_mm,
        signals,
    )


def disc_signals(jacobian: Array, mesh: Mesh, centres_mm: Array, radius_mm: float) -> Array:
    """Readings (g, t) of discs at (t, 2), of small contrast, per mm² of them on the sheet, by exact overlap."""
    reach = radius_mm + float(reaches_mm(mesh).max())
    near = neighbours(mesh.centroids_mm, centres_mm, reach)
    target = np.repeat(np.arange(len(centres_mm)), [len(elements) for elements in near])
    element = np.concatenate(near)
    covered = circle_overlap_mm2(mesh.corners_mm[element] - centres_mm[target][:, None], (0.0, 0.0), radius_mm)
    total = np.bincount(target, covered, minlength=len(centres_mm))
    share = covered / mesh.areas_mm2[element] / total[target]
    shares = sparse.csr_array((share, (target, element)), shape=(len(centres_mm), len(mesh.elements)))
    return np.asarray(shares @ jacobian.T).T


def node_areas_mm2(mesh: Mesh) -> Array:
    """A third of the area of the elements around each node, (n,): weights of an integral of nodal values."""
    areas = np.bincount(mesh.elements.ravel(), np.repeat(mesh.areas_mm2 / 3, 3), minlength=len(mesh.nodes_mm))
    return np.asarray(areas, dtype=np.float64)


def neighbours(points_mm: Array, places_mm: Array, reach_mm: float) -> list[Indices]:
    """For each place the indices of the points within reach, rising."""
    indices_by_place: Any = cKDTree(points_mm).query_ball_point(places_mm, reach_mm, return_sorted=True)
    return [np.asarray(near, dtype=np.int64) for near in indices_by_place]


def _thin_out(nodes: Array, distance: float) -> Indices:
    """Indices of nodes no closer than a distance to each other: all of them on the usual image mesh."""
    pairs = cKDTree(nodes).query_pairs(distance, output_type="ndarray")
    keep = np.ones(len(nodes), dtype=np.bool_)
    for first, second in pairs[np.lexsort(pairs.T[::-1])]:
        if keep[first]:
            keep[second] = False
    return np.flatnonzero(keep)
