"""Registration of seen to nominal places: shift, rotation, scale, and the residual errors."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain import Array, NumericsError

_FEWEST: Final = 3  # places: two are met by any similarity exactly
_ROUNDING: Final = 1e-12  # of squared distances
_SEEN_APART: Final = 1e-9  # of the distances that were pressed; less is one place
_MIRRORED: Final = 0.9  # share of where places are seen that a mirror image must explain to be one …
_CLEARLY: Final = 0.1  # … and share of what a turn leaves unexplained that it may leave


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Similarity q = b + s R(θ) p that maps nominal places p to where they were seen, by least squares.

    Parameters
    ----------
    shift_mm : (2,) where the origin is seen, b.
    rotation_deg : θ, counterclockwise.
    scale : s.
    shift_stderr_mm, rotation_stderr_deg, scale_stderr : standard errors, of each component of the shift alike, from
        the scatter of what is left.
    residuals_mm : (n, 2) seen places less those of the similarity, turned and scaled back onto the nominal ones.
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
    """Find the similarity that explains most of the errors of places, by complex regression (Umeyama 1991 by an SVD).

    Errors of places are taken as independent and alike along x and y. Places are (n, 2), n at least 3.

    Raises
    ------
    NumericsError
        If there are fewer than three places, two distinct ones are lacking, a number is not finite, all are seen at
        one place, in the order of a mirror image, or in no order that any turn explains.
    """
    if nominal_mm.shape != seen_mm.shape or nominal_mm.ndim != 2 or nominal_mm.shape[1:] != (2,):
        raise NumericsError(f"places {nominal_mm.shape} and {seen_mm.shape} do not match; both must be (n, 2)")
    count = len(nominal_mm)
    if count < _FEWEST:
        some = "1 place says" if count == 1 else f"{count} places say"
        raise NumericsError(f"{some} nothing about a registration", remedy="three or more are needed")
    p, q = (places[:, 0] + 1j * places[:, 1] for places in (nominal_mm, seen_mm))
    if not (np.isfinite(p) & np.isfinite(q)).all():
        raise NumericsError("a place of a registration is not finite")
    # Both about their own middles: the origin may be far from all of them.
    centred, seen = p - p.mean(), q - q.mean()
    size, seen_size = float((np.abs(centred) ** 2).sum()), float((np.abs(seen) ** 2).sum())
    if _one_place(p, size):
        raise NumericsError("all loads were pressed at one place", remedy="press at different places")
    if _one_place(q, seen_size) or seen_size < _SEEN_APART**2 * size:
        raise NumericsError("all loads are seen at one place, wherever they were pressed")
    factor = complex((centred.conj() * seen).sum() / size)
    _not_mirrored(factor, complex((centred * seen).sum() / size), seen_size / size)
    offset = complex(q.mean() - factor * p.mean())
    left = seen - factor * centred
    variance = float((np.abs(left) ** 2).sum()) / (2 * count - 4)  # of one coordinate
    of_factor = float(np.sqrt(variance / size))
    of_offset = float(np.sqrt(variance * (1 / count + abs(p.mean()) ** 2 / size)))
    back = left / factor
    return Registration(
        np.array([offset.real, offset.imag]),
        float(np.degrees(np.angle(factor))),
        abs(factor),
        of_offset,
        float(np.degrees(of_factor / abs(factor))),
        of_factor,
        np.column_stack([back.real, back.imag]),
    )


def _one_place(places: NDArray[np.complex128], size: float) -> bool:
    """Whether places are apart by rounding alone; ``size`` sums their squared distances from their middle."""
    rounding = max(1e-9, 8 * float(np.finfo(np.float64).eps * np.abs(places).max()))
    return not size > len(places) * rounding**2


def _not_mirrored(factor: complex, mirrored: complex, size: float) -> None:
    """Refuse places that no turn explains.

    ``factor``, ``mirrored``: that map the places, or their mirror image, onto what is seen; ``size``: squared
    distances seen over those pressed.
    """
    turned_left, mirrored_left = size - abs(factor) ** 2, size - abs(mirrored) ** 2
    if abs(mirrored) ** 2 >= _MIRRORED * size and mirrored_left < _CLEARLY * turned_left - _ROUNDING * size:
        raise NumericsError(
            "the places seen are a mirror image of the places pressed",
            remedy="check whether the sheet is upside down or its electrodes are numbered in the other direction",
        )
    if abs(factor) ** 2 < _SEEN_APART**2 * size:
        raise NumericsError("no rotation and scale explains where loads are seen")
