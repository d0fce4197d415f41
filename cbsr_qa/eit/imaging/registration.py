"""Registration of measured to nominal places: shift, rotation, scale, and the residual errors."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array

_FEWEST: Final = 3  # places: any two are fitted exactly by a similarity
_ROUNDING: Final = 1e-12  # share of squared distances that is rounding
_SEEN_APART: Final = 1e-9  # share of the pressed distances; less is a single place
_MIRRORED: Final = 0.9  # least share that a mirror image must explain …
_CLEARLY: Final = 0.1  # … and largest share that it may leave of what a rotation leaves unexplained


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Least-squares similarity q = b + s R(θ) p from nominal places p to measured places.

    Parameters
    ----------
    shift_mm : (2,) measured place of the origin, b.
    rotation_deg : θ, counterclockwise.
    scale : s.
    shift_stderr_mm, rotation_stderr_deg, scale_stderr : standard errors (equal for both components of the shift) from
        the scatter of the residuals.
    residuals_mm : (n, 2) measured places less those of the similarity, rotated and scaled back to nominal
        coordinates.
    """

    shift_mm: Array
    rotation_deg: float
    scale: float
    shift_stderr_mm: float
    rotation_stderr_deg: float
    scale_stderr: float
    residuals_mm: Array

    @property
    def errors_mm(self) -> Array:
        """Residual error of each place, (n,) [mm]."""
        return np.hypot(self.residuals_mm[:, 0], self.residuals_mm[:, 1])


def register(nominal_mm: Array, seen_mm: Array) -> Registration:
    """Fit the similarity by complex regression (Umeyama 1991 uses an SVD).

    Errors of places are assumed independent and equal along x and y. Places are (n, 2), n at least 3.

    Raises
    ------
    NumericsError
        If there are fewer than three places, or no two distinct ones, a number is not finite, or the measured places
        coincide, are mirrored, or fit no rotation.
    """
    if nominal_mm.shape != seen_mm.shape or nominal_mm.ndim != 2 or nominal_mm.shape[1:] != (2,):
        raise NumericsError(f"places {nominal_mm.shape} and {seen_mm.shape} do not match; both must be (n, 2)")
    count = len(nominal_mm)
    if count < _FEWEST:
        count_words = "1 place says" if count == 1 else f"{count} places say"
        raise NumericsError(f"{count_words} nothing about a registration", remedy="three or more are needed")
    p, q = (places[:, 0] + 1j * places[:, 1] for places in (nominal_mm, seen_mm))
    if not (np.isfinite(p) & np.isfinite(q)).all():
        raise NumericsError("a place of a registration is not finite")
    # Both relative to their means: the origin may be far from all places.
    nominal_centred, seen_centred = p - p.mean(), q - q.mean()
    size, seen_size = float((np.abs(nominal_centred) ** 2).sum()), float((np.abs(seen_centred) ** 2).sum())
    if _is_one_place(p, size):
        raise NumericsError("all loads were pressed at one place", remedy="press at different places")
    if _is_one_place(q, seen_size) or seen_size < _SEEN_APART**2 * size:
        raise NumericsError("all loads are seen at one place, wherever they were pressed")
    factor = complex((nominal_centred.conj() * seen_centred).sum() / size)
    _refuse_mirrored(factor, complex((nominal_centred * seen_centred).sum() / size), seen_size / size)
    offset = complex(q.mean() - factor * p.mean())
    residual = seen_centred - factor * nominal_centred
    variance = float((np.abs(residual) ** 2).sum()) / (2 * count - 4)  # variance of one coordinate
    factor_stderr = float(np.sqrt(variance / size))
    offset_stderr = float(np.sqrt(variance * (1 / count + abs(p.mean()) ** 2 / size)))
    nominal_residual = residual / factor
    return Registration(
        np.array([offset.real, offset.imag]),
        float(np.degrees(np.angle(factor))),
        abs(factor),
        offset_stderr,
        float(np.degrees(factor_stderr / abs(factor))),
        factor_stderr,
        np.column_stack([nominal_residual.real, nominal_residual.imag]),
    )


def _is_one_place(places: NDArray[np.complex128], size: float) -> bool:
    """Whether places differ by rounding only; ``size`` sums their squared distances from their mean."""
    rounding = max(1e-9, 8 * float(np.finfo(np.float64).eps * np.abs(places).max()))
    return not size > len(places) * rounding**2


def _refuse_mirrored(factor: complex, mirrored: complex, size: float) -> None:
    """Refuse places that no rotation explains.

    ``factor``, ``mirrored``: maps of the places, or their mirror image, onto the measured ones; ``size``: ratio of
    squared distances, measured over nominal.
    """
    turned_left, mirrored_left = size - abs(factor) ** 2, size - abs(mirrored) ** 2
    if abs(mirrored) ** 2 >= _MIRRORED * size and mirrored_left < _CLEARLY * turned_left - _ROUNDING * size:
        raise NumericsError(
            "the places seen are a mirror image of the places pressed",
            remedy="check whether the sheet is upside down or its electrodes are numbered in the other direction",
        )
    if abs(factor) ** 2 < _SEEN_APART**2 * size:
        raise NumericsError("no rotation and scale explains where loads are seen")
