"""Cramér–Rao bound of a round load's place, size and strength."""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.estimate.readings import MergedReadings
from cbsr_qa.eit.loads.round_load import RoundLoadModel, RoundLoads


@dataclass(frozen=True, slots=True, eq=False)
class LoadBound:
    """Bounds of one load.

    Parameters
    ----------
    detectability : d′ = √(sᵀ Σ⁻¹ s) of its signal s in noise Σ.
    covariance : (4, 4) of x, y [mm], strength and square [mm²]; zero for the square where the radius is known.
    radius_mm, contrast : of the load.
    """

    detectability: float
    covariance: Array
    radius_mm: float
    contrast: float

    @property
    def place_mm(self) -> float:
        """Of the place, root mean square over two axes [mm]."""
        return float(np.sqrt((self.covariance[0, 0] + self.covariance[1, 1]) / 2))

    @property
    def radius_stderr_mm(self) -> float:
        """Of the radius [mm]; 0 where it is known."""
        return float(np.sqrt(self.covariance[3, 3]) / (2 * self.radius_mm))

    @property
    def strength(self) -> float:
        """Of the strength, and of area × contrast against the mean of both conductances: relative."""
        return float(np.sqrt(self.covariance[2, 2]) / abs(self._strength))

    @property
    def plain_area_contrast(self) -> float:
        """Of area × Δγ/γ, relative."""
        strength, square = self._strength, self.radius_mm**2
        mean = strength / square
        gradient = np.array([0, 0, 1 / strength, -mean / square]) / (1 - mean)
        return float(np.sqrt(gradient @ self.covariance @ gradient))

    @property
    def contrast_stderr(self) -> float:
        """Of the contrast where the radius is known."""
        mean = self._strength / self.radius_mm**2
        return float(2 * np.sqrt(self.covariance[2, 2]) / self.radius_mm**2 / (1 - mean) ** 2)

    @property
    def _strength(self) -> float:
        return self.radius_mm**2 * self.contrast / (2 + self.contrast)


def load_bound(
    model: RoundLoadModel,
    readings: MergedReadings,
    *,
    x_mm: float,
    y_mm: float,
    radius_mm: float,
    contrast: float,
    known: bool,
) -> LoadBound:
    """Invert the Fisher matrix of a load.

    Raises
    ------
    NumericsError
        If the readings say nothing about one of the unknowns.
    """
    load = RoundLoads.from_contrast(np.array([[x_mm, y_mm]]), np.array([radius_mm]), np.array([contrast]))
    found = model.readings(load)
    signal, slopes = readings.merge_frames(found.change)[0], readings.merge_frames(found.slope)[0]
    free = slice(0, 3 if known else 4)
    size = np.linalg.norm(slopes[free], axis=1)
    if not (size > 0).all():
        raise NumericsError("the readings do not depend on the load at all")
    information = (slopes[free] / size[:, None]) @ (slopes[free] / size[:, None]).T
    covariance = np.zeros((4, 4))
    covariance[free, free] = np.linalg.inv(information) / np.outer(size, size)
    return LoadBound(float(np.linalg.norm(signal)), covariance, radius_mm, contrast)
