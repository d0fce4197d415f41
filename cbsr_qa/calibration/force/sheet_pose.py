"""Pose of a sheet on the station: loads are mapped to the sheet before learning."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.force.template_matching import Matches
from cbsr_qa.domain.numbers import Array

#: Largest error of a place that helps to determine the pose [mm].
_MAX_STDERR_MM: Final = 1.5
#: Fewest places for a pose, and standard errors by which it must differ from none.
_MIN_PLACES: Final = 3
_MIN_STDERRS: Final = 4.0
#: Largest shift of a place by a pose that is ignored [mm].
_SMALLEST_MM: Final = 0.15


@dataclass(frozen=True, slots=True)
class SheetPose:
    """Rigid motion from places of the station to places on the sheet: q = b + R(θ) p.

    Parameters
    ----------
    shift_mm : b.
    rotation_deg : θ, counterclockwise.
    shift_stderr_mm, rotation_stderr_deg : standard errors, equal for both components of the shift.
    moved : True if the pose differs clearly from none; False leaves places unchanged.
    """

    shift_mm: tuple[float, float] = (0.0, 0.0)
    rotation_deg: float = 0.0
    shift_stderr_mm: float = 0.0
    rotation_stderr_deg: float = 0.0
    moved: bool = False

    def places_mm(self, nominal_mm: Array) -> Array:
        """Places (n, 2) on the sheet of places on the station."""
        if not self.moved:
            return nominal_mm
        angle = np.radians(self.rotation_deg)
        x, y = nominal_mm.T
        cos, sin = np.cos(angle), np.sin(angle)
        # Elementwise, unlike a product of matrices, so that equal places stay equal to the last bit.
        places: Array = np.column_stack([cos * x - sin * y, sin * x + cos * y]) + np.array(self.shift_mm)
        return places


#: A sheet at its nominal pose.
AS_PLACED: Final = SheetPose()


def sheet_pose_of(nominal_mm: Array, matches: Matches, noise: Array) -> SheetPose:
    """Estimate the pose of a sheet from the found places of its loads.

    Rigid least squares, weighted by the noise of each place; without a scale, since an uneven sheet seems scaled but
    none is.

    Parameters
    ----------
    nominal_mm : (n, 2) pressed places.
    matches : matches of the same loads.
    noise : (n,) variance of the rows of the loads.

    Returns
    -------
    The pose, or no motion if fewer than 3 different places are known to 1.5 mm, or if it differs from none by less
    than 4 standard errors, estimated from the residuals.
    """
    variance = matches.covariance[:, [1, 2], [1, 2]].mean(axis=1) * noise
    sure_mask = np.isfinite(matches.place_mm).all(axis=1) & (variance > 0) & (variance < _MAX_STDERR_MM**2)
    if len(np.unique(nominal_mm[sure_mask], axis=0)) < _MIN_PLACES:
        return AS_PLACED
    # Besides noise, an uneven sheet moves every place slightly: no load outweighs all others.
    weight = 1 / (variance[sure_mask] + float(np.median(variance[sure_mask])))
    p, q = (places[sure_mask] @ np.array([1, 1j]) for places in (nominal_mm, matches.place_mm))
    distance_mm = np.abs((q - p) - np.median((q - p).real) - 1j * np.median((q - p).imag))
    stray_mm = max(5 * float(np.median(distance_mm)), 3.0)
    return _fit_pose(p, q, np.where(distance_mm <= stray_mm, weight, 0.0))


def _fit_pose(p: NDArray[np.complex128], q: NDArray[np.complex128], weight: Array) -> SheetPose:
    total = float(weight.sum())
    nominal_middle, seen_middle = complex(weight @ p) / total, complex(weight @ q) / total
    size = float(weight @ np.abs(p - nominal_middle) ** 2)
    if not size > 0:
        return AS_PLACED
    turn = complex(weight @ ((p - nominal_middle).conj() * (q - seen_middle)))
    angle = float(np.angle(turn))
    shift = seen_middle - np.exp(1j * angle) * nominal_middle
    squared_residual = np.abs(q - shift - np.exp(1j * angle) * p) ** 2
    count = int((weight > 0).sum())
    variance = float(weight @ squared_residual) / (2 * count - 3)  # variance of one coordinate of weight one
    angle_stderr = float(np.sqrt(variance / size))
    shift_stderr = float(np.sqrt(variance * (1 / total + abs(nominal_middle) ** 2 / size)))
    is_clear = abs(shift) > _MIN_STDERRS * shift_stderr or abs(angle) > _MIN_STDERRS * angle_stderr
    furthest = float(np.abs(shift + (np.exp(1j * angle) - 1) * p).max())
    return SheetPose(
        (shift.real, shift.imag),
        float(np.degrees(angle)),
        shift_stderr,
        float(np.degrees(angle_stderr)),
        is_clear and furthest > _SMALLEST_MM,
    )
