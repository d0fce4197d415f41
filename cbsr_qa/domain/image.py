"""Images: one value per mesh element, and the blobs found in them."""

from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True, eq=False)
class Blob:
    """Connected elements that survived the masks.

    Parameters
    ----------
    image : the response-signed image, noise floor subtracted, that was masked.
    elements : (k,) int64 indices into its mesh, rising, at least one.
    """

    image: Image
    elements: NDArray[np.int64]

    @property
    def area_mm2(self) -> float:
        """Area A_b [mm²]."""
        return float(self.image.mesh.areas_mm2[self.elements].sum())

    @property
    def weight(self) -> float:
        """Integral of the values over the blob [mm²]."""
        return float(self.image.values[self.elements] @ self.image.mesh.areas_mm2[self.elements])

    def centre_mm(self) -> NDArray[np.float64]:
        """Centre of mass M, area- and value-weighted: (2,) [mm]."""
        mesh = self.image.mesh
        weights = self.image.values[self.elements] * mesh.areas_mm2[self.elements]
        centre: NDArray[np.float64] = weights @ mesh.centroids_mm[self.elements] / weights.sum()
        return centre
