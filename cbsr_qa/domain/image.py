"""Images: one value per mesh element, and the regions found in them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.mesh import Mesh


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """Relative conductance change Δγ/γ₀ per element, positive where the material conducts more.

    Parameters
    ----------
    mesh : of e elements.
    values : (e,) float64, relative.
    """

    mesh: Mesh
    values: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.values.shape != (len(self.mesh.elements),):
            raise RefusedError(f"an image of {self.values.shape} does not fit {len(self.mesh.elements)} elements")
        if not np.isfinite(self.values).all():
            raise RefusedError("an image holds values that are not finite numbers")


class Region(Protocol):
    """A sensed region, of whole elements or bounded by a contour: what the figures of merit look at."""

    @property
    def area_mm2(self) -> float:
        """Area A_b [mm²]."""
        ...

    @property
    def weight(self) -> float:
        """Integral of the image over the region [mm²]."""
        ...

    def centre_mm(self) -> NDArray[np.float64]:
        """Centre of mass M of the image over the region: (2,) [mm]."""
        ...

    def rim_mm(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Starts and ends (k, 2) [mm] of the straight pieces of the perimeter, the region to their left."""
        ...


@dataclass(frozen=True, eq=False)
class Blob:
    """Connected elements that survived the masks.

    Parameters
    ----------
    image : the response-signed image, noise floor subtracted, that was masked.
    elements : (k,) int64 indices into its mesh, rising, at least one.
    """

    image: Image
    elements: NDArray[np.int64]

    @cached_property
    def area_mm2(self) -> float:
        """Area A_b [mm²]."""
        return float(self.image.mesh.areas_mm2[self.elements].sum())

    @cached_property
    def weight(self) -> float:
        """Integral of the values over the blob [mm²]."""
        return float(self._weights.sum())

    def centre_mm(self) -> NDArray[np.float64]:
        """Centre of mass M, area- and value-weighted: (2,) [mm]."""
        centre: NDArray[np.float64] = self._weights @ self.image.mesh.centroids_mm[self.elements] / self.weight
        return centre

    @cached_property
    def rim(self) -> NDArray[np.int64]:
        """Edges of exactly one element of the blob, holes' rims included: (k, 2) nodes, the blob to their left."""
        mesh = self.image.mesh
        edges = mesh.element_edges[self.elements]
        alone = np.bincount(edges.ravel())[edges] == 1
        corners = mesh.elements[self.elements]
        rim: NDArray[np.int64] = np.column_stack([corners[alone], corners[:, [1, 2, 0]][alone]])
        return rim

    def rim_mm(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Starts and ends (k, 2) [mm] of the rim's edges."""
        nodes_mm = self.image.mesh.nodes_mm
        return nodes_mm[self.rim[:, 0]], nodes_mm[self.rim[:, 1]]

    @cached_property
    def _weights(self) -> NDArray[np.float64]:
        weights: NDArray[np.float64] = self.image.values[self.elements] * self.image.mesh.areas_mm2[self.elements]
        return weights
