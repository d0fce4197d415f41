"""Propagation of noise and of left-out readings to images and places."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.inverse.noise_figures import target_radius_mm
from cbsr_qa.eit.inverse.problem import find_masked_electrodes

#: Share of the radius beyond which places are in the electrodes' own neighbourhood.
_OUTERMOST: Final = 0.8
_PLACES: Final = 150
#: Factor by which the standard error of a place grows if it is hardly seen; all readings together would place the
#: same load within 1 mm.
_HARDLY: Final = 10.0


@dataclass(frozen=True, slots=True)
class MaskingEffect:
    """Loss of accuracy of places when readings are left out.

    Parameters
    ----------
    electrodes : electrodes without any remaining reading.
    left, of : remaining readings and all.
    typical, worst : median and largest ratio of the place's standard error to that with all readings.
    worst_x_mm, worst_y_mm : place of the largest.
    hardly_seen : share of the places where the ratio is above 10.
    """

    electrodes: tuple[int, ...]
    left: int
    of: int
    typical: float
    worst: float
    worst_x_mm: float
    worst_y_mm: float
    hardly_seen: float

    def words(self, radius_mm: float | None = None) -> str:
        """One sentence for a report; in units of ``radius_mm`` if given (a sheet of unknown size)."""
        unit_mm, unit = (1.0, "mm") if radius_mm is None else (radius_mm, "radii")
        x, y = self.worst_x_mm / unit_mm, self.worst_y_mm / unit_mm
        numbers = [str(number) for number in self.electrodes]
        number_list = ", ".join(numbers[:-1]) + f" and {numbers[-1]}" if len(numbers) > 1 else "".join(numbers)
        left_out = f"electrode{'s' if len(numbers) > 1 else ''} {number_list}" if numbers else "some readings"
        return (
            f"images are made without {left_out}, from {self.left} of {self.of} readings: the place of a load is"
            f" {self.typical:.1f} times as uncertain as with all of them (median over the sheet), at"
            f" ({x:.2g}, {y:.2g}) {unit} {self.worst:.1f} times"
            + (f"; {self.hardly_seen:.0%} of the sheet is hardly seen" if self.hardly_seen else "")
        )


def masking_effect(problem: ImagingProblem) -> MaskingEffect | None:
    """Compare the Cramér–Rao bounds on a load's place with those of all readings, at equal noise.

    Place and strength of a smooth bump as wide as the indenter are unknown, its size is known; places up to 0.8 of
    the way to the sheet's edge. None if no reading is left out.
    """
    if problem.nominal is None or len(problem.reference) == len(problem.nominal.reference):
        return None
    places = _places(problem)
    jacobian, is_kept = problem.nominal.jacobian, problem.used[problem.nominal.used]
    patterns = jacobian @ _bumps(problem, places)
    all_bounds, kept_bounds = (
        _place_bounds(rows.reshape(len(rows), 3, -1)) for rows in (patterns, patterns[is_kept])
    )
    ratio = kept_bounds / all_bounds
    worst = int(np.argmax(ratio))
    return MaskingEffect(
        find_masked_electrodes(problem.sensor_type.pattern, problem.used),
        int(is_kept.sum()),
        len(is_kept),
        float(np.median(ratio)),
        float(ratio[worst]),
        float(places[worst, 0]),
        float(places[worst, 1]),
        float((ratio > _HARDLY).mean()),
    )


def _places(problem: ImagingProblem) -> Array:
    """About 150 places of elements, spread over the sheet except near its edge."""
    outline, centroids = problem.sensor_type.outline, problem.mesh.centroids_mm
    clear = outline.clearance_mm(centroids)
    inner = np.flatnonzero(clear >= (1 - _OUTERMOST) * clear.max())
    return centroids[inner[:: max(1, len(inner) // _PLACES)]]


def _bumps(problem: ImagingProblem, places: Array) -> Array:
    """Bumps at the places, and their derivatives along x and y: (e, 3 p)."""
    width = target_radius_mm(problem) / 2
    offset = problem.mesh.centroids_mm[:, None] - places[None]
    bump = np.exp(-(offset**2).sum(axis=2) / (2 * width**2))
    slopes = offset * bump[..., None] / width**2
    return np.hstack([bump, slopes[..., 0], slopes[..., 1]])


def _place_bounds(patterns: Array) -> Array:
    """Standard error of the place, up to a factor of noise, from patterns and their derivatives (m, 3, p): (p,)."""
    information = np.einsum("map,mbp->pab", patterns, patterns)
    size = np.sqrt(np.einsum("paa->pa", information))
    scaled = information / (size[:, :, None] * size[:, None, :])  # lengths and strengths have different units
    covariance = np.linalg.pinv(scaled, hermitian=True)
    bounds: Array = np.sqrt((np.einsum("paa->pa", covariance) / size**2)[:, 1:].sum(axis=1))
    return bounds
