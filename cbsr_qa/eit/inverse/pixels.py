"""Linear images on square pixels: one matrix from readings to pixels.

A pixel is the mean of the image over the part of the sheet it covers, by exact overlap. The matrix takes folded
readings and is kept in single precision: rounding 144 dB below the readings.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.imaging import LinearReconstruction
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.inverse.overlap import overlap_pieces
from cbsr_qa.eit.inverse.readings import ReadingFold

Pixels = NDArray[np.float32]

_SAME: Final = 1e-9  # columns in proportion, and weights
_REAL: Final = frozenset("fiu")  # dtype kinds that readings may have


@dataclass(frozen=True, slots=True, eq=False)
class PixelImaging:
    """A linear reconstruction on a square raster.

    Parameters
    ----------
    pixels : on each side.
    pitch_mm : width of a pixel.
    first_mm : place (x, y) of the centre of pixel [0, 0]; rows rise with y, columns with x.
    places : (p,) pixels that cover some of the sheet, in C order; all others are zero.
    matrix : (pixels², g) float32, from folded readings.
    inner : (p, g) its non-zero rows, which suffice for one frame and fit a core's cache.
    one, other : (g,) readings that are folded, reciprocal ones in most methods.
    ratio : (g,) weight of the second over that of the first, which is in the matrix; 0 for single readings, None if
        always one.
    readings : m.
    """

    pixels: int
    pitch_mm: float
    first_mm: tuple[float, float]
    places: Indices
    matrix: Pixels
    inner: Pixels
    one: Indices
    other: Indices
    ratio: Array | None
    readings: int

    @property
    def inside(self) -> Mask:
        """Pixels that cover some of the sheet, (pixels, pixels)."""
        is_inside = np.zeros(self.pixels * self.pixels, dtype=np.bool_)
        is_inside[self.places] = True
        return is_inside.reshape(self.pixels, self.pixels)

    def image(self, changes: Array) -> Pixels:
        """Image one frame of scaled changes (m,): (pixels, pixels) float32, relative conductance change.

        RefusedError if the number of readings is not the prepared one, or one is not finite.
        """
        if changes.shape != (self.readings,) or changes.dtype.kind not in _REAL:
            raise self._unfit(changes)
        # A sum of squares is not finite if a reading is not, and costs a third of checking each.
        if not math.isfinite(changes.dot(changes)):
            _check_finite(changes)
        second = changes[self.other] if self.ratio is None else changes[self.other] * self.ratio
        image = np.zeros(self.pixels * self.pixels, np.float32)
        image[self.places] = self.inner @ (changes[self.one] + second).astype(np.float32)
        return image.reshape(self.pixels, self.pixels)

    def _unfit(self, changes: Array) -> RefusedError:
        description = f"readings of shape {changes.shape} and type {changes.dtype}"
        return RefusedError(f"{description} do not match {self.readings} used channels of real numbers")

    def images(self, changes: Array) -> Pixels:
        """Image n frames (n, m), as in :meth:`image`: (n, pixels, pixels)."""
        if changes.ndim != 2 or changes.shape[1] != self.readings or changes.dtype.kind not in _REAL:
            raise self._unfit(changes)
        _check_finite(changes)
        second = changes[:, self.other] if self.ratio is None else changes[:, self.other] * self.ratio
        images: Pixels = (changes[:, self.one] + second).astype(np.float32) @ self.matrix.T
        return images.reshape(-1, self.pixels, self.pixels)


def pixel_imaging(reconstruction: LinearReconstruction, pixels: int = 32) -> PixelImaging:
    """Put a linear reconstruction on a raster over the extent of its sheet; NumericsError without pixels."""
    if pixels < 1:
        raise NumericsError(f"raster has {pixels} pixels a side; it must have at least 1")
    problem = reconstruction.problem
    low_x, high_x, low_y, high_y = problem.sensor_type.outline.extent_mm
    pitch = max(high_x - low_x, high_y - low_y) / pixels
    corner = np.array([(low_x + high_x) / 2, (low_y + high_y) / 2]) - pitch * pixels / 2
    shares = _shares(problem.mesh, corner, pitch, pixels)
    places = np.flatnonzero(np.diff(shares.indptr))
    pixel_matrix = np.asarray(shares @ reconstruction.matrix)
    first_readings, second_readings, ratio = _pairs(pixel_matrix, ReadingFold.from_problem(problem).group)
    x, y = (corner + pitch / 2).tolist()
    return PixelImaging(
        pixels,
        float(pitch),
        (x, y),
        places.astype(np.int64),
        np.ascontiguousarray(pixel_matrix[:, first_readings], dtype=np.float32),
        np.ascontiguousarray(pixel_matrix[places][:, first_readings], dtype=np.float32),
        first_readings,
        second_readings,
        None if (ratio == 1).all() else ratio,
        len(problem.reference),
    )


def _shares(mesh: Mesh, corner: Array, pitch: float, pixels: int) -> sparse.csr_matrix:
    """Share of each element in the mean over each pixel's part of the sheet, (pixels², e); rows sum to 1 or 0."""
    lines = corner + pitch * np.arange(pixels + 1)[:, None]
    nodes = np.column_stack([coordinate.ravel() for coordinate in np.meshgrid(lines[:, 0], lines[:, 1])])
    first = (np.arange(pixels)[:, None] * (pixels + 1) + np.arange(pixels)).ravel()
    lower = np.column_stack([first, first + 1, first + pixels + 2])
    upper = np.column_stack([first, first + pixels + 2, first + pixels + 1])
    pieces = overlap_pieces(mesh, Mesh(nodes, np.vstack([lower, upper]).astype(np.int64)))
    pixel = pieces.coarse % pixels**2
    covered = np.bincount(pixel, pieces.areas_mm2, minlength=pixels**2)
    share = pieces.areas_mm2 / covered[pixel]
    return sparse.csr_matrix((share, (pixel, pieces.fine)), shape=(pixels**2, len(mesh.elements)))


def _pairs(matrix: Array, group: Indices) -> tuple[Indices, Indices, Array]:
    """Columns proportional to another in the same group: the first, the second, and their ratio."""
    first_readings: list[int] = []
    second_readings: list[int] = []
    ratios: list[float] = []
    place_by_group: dict[int, int] = {}
    for reading, name in enumerate(group.tolist()):
        place = place_by_group.pop(name, None)
        if place is None:
            place_by_group[name] = len(first_readings)
        else:
            first_column, second_column = matrix[:, first_readings[place]], matrix[:, reading]
            size = float(first_column @ first_column)
            scale = float(first_column @ second_column) / size if size else 1.0
            if np.abs(second_column - scale * first_column).max() <= _SAME * np.abs(second_column).max():
                # One, if it equals one within rounding.
                exact_scale = 1.0 if abs(scale - 1) <= _SAME else scale
                second_readings[place], ratios[place] = reading, exact_scale
                continue
        first_readings.append(reading)
        second_readings.append(reading)
        ratios.append(0.0)
    return np.array(first_readings), np.array(second_readings), np.array(ratios)


def _check_finite(changes: Array) -> None:
    if not np.isfinite(changes).all():
        raise RefusedError("a reading is not a finite number; mask its channel instead of imaging it")
