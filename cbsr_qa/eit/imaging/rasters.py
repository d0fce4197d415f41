"""Images on square pixels (GREIT, pixel plugins), by scikit-image: contours, regions, watershed of touching loads."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import skimage.feature
import skimage.measure
import skimage.segmentation
from scipy.ndimage import gaussian_filter

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.imaging.blobs import percentage_mask, threshold

# scikit-image has no type stubs for these.
_feature: Final[Any] = skimage.feature
_measure: Final[Any] = skimage.measure
_segmentation: Final[Any] = skimage.segmentation


@dataclass(frozen=True, slots=True, eq=False)
class Raster:
    """Relative conductance change per pixel, response-signed, noise floor subtracted.

    Parameters
    ----------
    values : (rows, columns) float64; rows rise with y, columns with x.
    pitch_mm : width of a pixel.
    first_mm : (x, y) centre of pixel [0, 0].
    """

    values: Array
    pitch_mm: float
    first_mm: tuple[float, float]

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or not np.isfinite(self.values).all() or not self.pitch_mm > 0:
            raise NumericsError(
                f"a raster of shape {self.values.shape} and pitch {self.pitch_mm} mm"
                " must be two-dimensional, finite and of positive pitch"
            )

    def places_mm(self, pixels: Array) -> Array:
        """Places of (row, column) pairs, which may be fractional: (k, 2) → (k, 2) of x and y [mm]."""
        return np.asarray(self.first_mm) + self.pitch_mm * pixels[:, ::-1]


@dataclass(frozen=True, slots=True, eq=False)
class PixelRegion:
    """Connected pixels that survived a mask, with the contour around them.

    Parameters
    ----------
    pixels : (rows, columns) bool.
    centre : value-weighted centre of mass of the pixels, (2,) [mm].
    area_mm2 : inside the contour.
    weight : sum of the pixels' values, times a pixel's area [mm²].
    start_mm, end_mm : (k, 2) straight pieces of the contour, the region to their left.
    """

    pixels: Mask
    centre: Array
    area_mm2: float
    weight: float
    start_mm: Array
    end_mm: Array

    def centre_mm(self) -> Array:
        """Centre of mass M, (2,) [mm]."""
        return self.centre

    def rim_mm(self) -> tuple[Array, Array]:
        """Starts and ends (k, 2) [mm] of the contour's pieces."""
        return self.start_mm, self.end_mm


def find_regions(raster: Raster, fraction: float) -> tuple[PixelRegion, ...]:
    """Find the connected pixels of a percentage mask, over shared edges; heaviest first, empty for "no blob".

    NumericsError if the fraction is outside (0, 1).
    """
    keep, level = _mask_raster(raster, fraction)
    return _regions(raster, _measure.label(keep, connectivity=1), level)


def split_touching(raster: Raster, fraction: float, separation_mm: float) -> tuple[PixelRegion, ...]:
    """Find regions, and split those with several peaks along the valleys between them (watershed).

    Peaks closer than the separation belong to one load; the image is smoothed over a quarter of it first.

    NumericsError if the separation is not positive, or the fraction outside (0, 1).
    """
    if not separation_mm > 0:
        raise NumericsError(f"separation is {separation_mm} mm; it must be positive")
    keep, level = _mask_raster(raster, fraction)
    if not keep.any():
        return ()
    smooth = gaussian_filter(raster.values, separation_mm / 4 / raster.pitch_mm)
    distance = max(round(separation_mm / raster.pitch_mm / 2), 1)
    joined = _measure.label(keep, connectivity=1)
    peaks = _feature.peak_local_max(smooth, min_distance=distance, labels=joined, exclude_border=False)
    markers = np.zeros(keep.shape, dtype=np.int64)
    markers[tuple(peaks.T)] = np.arange(1, len(peaks) + 1)
    # A flat image has no peak, but its pixels are a region all the same.
    for peakless in np.setdiff1d(joined[keep], joined[markers > 0]):
        markers[joined == peakless] = markers.max() + 1
    return _regions(raster, _segmentation.watershed(-smooth, markers, mask=keep), level)


def pixel_image(raster: Raster, where: Mask | None = None) -> Image:
    """Return a raster as an image on a mesh, two triangles for each pixel of ``where`` (rows, columns), or of all.

    NumericsError if no pixel is left.
    """
    rows, columns = raster.values.shape
    kept_mask = np.ones(raster.values.shape, dtype=np.bool_) if where is None else where
    if not kept_mask.any():
        raise NumericsError("no pixel of the raster lies on the sheet")
    corners = np.stack(np.meshgrid(np.arange(rows + 1), np.arange(columns + 1), indexing="ij"), axis=-1) - 0.5
    row, column = np.nonzero(kept_mask)
    lower = row * (columns + 1) + column
    right, up, across = lower + 1, lower + columns + 1, lower + columns + 2
    halves = np.stack([np.column_stack([lower, right, across]), np.column_stack([lower, across, up])], axis=1)
    mesh = Mesh(raster.places_mm(corners.reshape(-1, 2)), halves.reshape(-1, 3))
    return Image(mesh, np.repeat(raster.values[kept_mask], 2))


def outlines(raster: Raster, level: float) -> tuple[Array, ...]:
    """Closed outlines (k, 2) [mm] at a level, by marching squares, longest first; above the level to their left."""
    contours = _measure.find_contours(np.pad(raster.values, 1), level, positive_orientation="high")
    # Rows rise with y: (row, column) to (x, y) is a reflection, which reverses outlines.
    closed = [raster.places_mm(contour[::-1] - 1) for contour in contours]
    return tuple(sorted(closed, key=lambda outline: -float(np.hypot(*np.diff(outline, axis=0).T).sum())))


def _mask_raster(raster: Raster, fraction: float) -> tuple[Mask, float]:
    if fraction == 1:
        raise NumericsError("a contour at the maximum itself encloses nothing", remedy="use a mask below 100 %")
    keep = percentage_mask(raster.values.ravel(), fraction).reshape(raster.values.shape)
    return keep, threshold(raster.values, fraction)


def _regions(raster: Raster, labels: Indices, level: float) -> tuple[PixelRegion, ...]:
    regions = []
    for properties in _measure.regionprops(labels, intensity_image=raster.values):
        pixels = labels == properties.label
        centre = raster.places_mm(np.array([properties.centroid_weighted]))[0]
        masked = Raster(
            np.where(pixels | (raster.values < level), raster.values, 0.0), raster.pitch_mm, raster.first_mm
        )
        pieces = outlines(masked, level)
        start, end = (np.concatenate([piece[ends] for piece in pieces]) for ends in (slice(-1), slice(1, None)))
        nonzero_mask = (start != end).any(axis=1)
        # Relative to one corner: products of places far from the origin would cancel in a small area.
        u, v = start - start[0], end - start[0]
        area = float((u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()) / 2
        weight = float(raster.values[pixels].sum()) * raster.pitch_mm**2
        regions.append(PixelRegion(pixels, centre, area, weight, start[nonzero_mask], end[nonzero_mask]))
    return tuple(sorted(regions, key=lambda region: -region.weight))
