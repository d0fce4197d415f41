"""Loads of the sensors of a batch, at the places that they share."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.sheet.response_map import find_places
from cbsr_qa.calibration.sheet.response_processes import CombinedLoads, combine_loads, measure_distances
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array

#: Variance that keeps the covariance of noiseless loads at one place invertible.
ROUNDING: Final = 1e-12
#: Share of the largest eigenvalue of a covariance below which the others are rounding.
_NEGLIGIBLE: Final = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class SensorLoads:
    """Loads of one sensor, as :func:`~cbsr_qa.calibration.sheet.response_map.learn_response` takes them.

    CalibrationError without a load, or if a number is not finite.

    Parameters
    ----------
    places_mm : (n, 2) places of the loads.
    log_response, variance : (n,) logarithm of the observed change over that of the line, and its variance by noise.
    bend : (n,) effect of a wrong intercept of the line; None without one.
    bend_stderr : prior standard deviation of its multiple.
    """

    places_mm: Array
    log_response: Array
    variance: Array
    bend: Array | None = None
    bend_stderr: float = 1.0

    def __post_init__(self) -> None:
        finite = np.isfinite(self.places_mm).all() and np.isfinite(self.log_response).all()
        if not (len(self.log_response) and finite and (self.variance >= 0).all()):
            raise CalibrationError(
                "a sensor of the batch has no load, or one whose place, response or variance is not finite",
                remedy="leave the sensor or the load out",
            )

    @property
    def columns(self) -> Array:
        """Columns (n, 3): ones, bend and values."""
        bend = np.zeros(len(self.log_response)) if self.bend is None else self.bend
        return np.column_stack([np.ones(len(bend)), bend, self.log_response])


class BatchLoads:
    """Loads of all sensors, with the places of the batch.

    Parameters
    ----------
    places_mm : (p, 2) places that any sensor was pressed at, each once.
    which : the places of each sensor, as indices into them.
    """

    def __init__(self, sensors: Sequence[SensorLoads]) -> None:
        self.sensors = tuple(sensors)
        self.places_mm, of_loads = find_places(np.concatenate([sensor.places_mm for sensor in sensors]))
        counts = np.cumsum([len(sensor.log_response) for sensor in sensors])[:-1]
        self.which: list[NDArray[np.intp]] = []
        self._place_of_load: list[NDArray[np.intp]] = []
        for places in np.split(of_loads, counts):
            own_places, place_of_load = np.unique(places, return_inverse=True)
            self.which.append(own_places)
            self._place_of_load.append(place_of_load)
        self.combine = lru_cache(maxsize=64)(self._combine)
        self.factor = lru_cache(maxsize=64)(self._factor)

    def _combine(self, scatter: float) -> list[CombinedLoads]:
        """Return each sensor's loads by place, with a scatter of single loads."""
        return [
            combine_loads(places, sensor.columns, sensor.variance + scatter**2 + ROUNDING, np.zeros((2, 2)))
            for sensor, places in zip(self.sensors, self._place_of_load, strict=True)
        ]

    def _factor(self, smooth: bool, length_mm: float) -> tuple[Array, Array]:
        """Return the correlations K (p, p) of the places, and L (p, r) with K = L Lᵀ but for rounding."""
        alike = correlate_places(self.places_mm, self.places_mm, length_mm, smooth)
        values, vectors = np.linalg.eigh(alike)
        kept = values > _NEGLIGIBLE * values[-1]
        return alike, vectors[:, kept] * np.sqrt(values[kept])


def correlate_places(one_mm: Array, other_mm: Array, length_mm: float, smooth: bool) -> Array:
    """Correlation (p, n) of maps at places (p, 2) and (n, 2): Gaussian if smooth, else Matérn 3/2.

    Single sheets have Matérn 5/2 instead. The sensors of a batch are pressed at the same places, so that only the
    assumed roughness says how far the map may turn between them. Intervals of 95 % of maps with a step hold in 91 to
    93 % with 3/2, and in 89 to 92 % with 5/2 (decision 0054).
    """
    distance = measure_distances(one_mm, other_mm) / length_mm
    if smooth:
        gaussian: Array = np.exp(-(distance**2) / 2)
        return gaussian
    scaled_distance = np.sqrt(3) * distance
    matern: Array = (1 + scaled_distance) * np.exp(-scaled_distance)
    return matern
