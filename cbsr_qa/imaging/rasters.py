"""Images on square pixels (GREIT and pixel plugins), by scikit-image: outlines, regions, touching loads parted."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import skimage.feature
import skimage.measure
import skimage.segmentation
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry import area_under_edges
from cbsr_qa.imaging.masks import percentage_mask
from cbsr_qa.imaging.shape import squared_deviation_integral

# scikit-image ships without types for these.
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
    first_mm : (x, y) of the centre of pixel [0, 0].
    """

    values: NDArray[np.float64]
    pitch_mm: float
    first_mm: tuple[float, float]

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or not np.isfinite(self.values).all() or not self.pitch_mm > 0:
            raise NumericsError(
                f"a raster of shape {self.values.shape} and pitch {self.pitch_mm} mm"
                " must be two-dimensional, finite and of positive pitch"
            )

    def places_mm(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Places of (row, column) pairs, which may be fractional: (k, 2) → (k, 2) of x and y [mm]."""
        places: NDArray[np.float64] = np.asarray(self.first_mm) + self.pitch_mm * pixels[:, ::-1]
        return places


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Connected pixels that survived a mask.

    Parameters
    ----------
    pixels : (rows, columns) bool.
    centre_mm : value-weighted centre of mass, (2,).
    area_mm2, weight_mm2 : number of pixels and sum of their values, times a pixel's area.
    """

    pixels: NDArray[np.bool_]
    centre_mm: NDArray[np.float64]
    area_mm2: float
    weight_mm2: float


def find_regions(raster: Raster, fraction: float) -> tuple[Region, ...]:
    """Find the connected pixels of a percentage mask, over shared edges; heaviest first, empty for "no blob"."""
    keep = percentage_mask(raster.values.ravel(), fraction).reshape(raster.values.shape)
    return _regions(raster, _measure.label(keep, connectivity=1))


def split_touching(raster: Raster, fraction: float, separation_mm: float) -> tuple[Region, ...]:
    """Find regions, and part those that hold several peaks along the valleys between them (watershed).

    Parameters
    ----------
    separation_mm : peaks closer than this belong to one load; the image is smoothed over a quarter of it first,
        so that noise on one load's plateau does not part it.

    Raises
    ------
    NumericsError
        If the separation is not positive.
    """
    if not separation_mm > 0:
        raise NumericsError(f"a separation of {separation_mm} mm does not tell loads apart; it must be positive")
    keep = percentage_mask(raster.values.ravel(), fraction).reshape(raster.values.shape)
    if not keep.any():
        return ()
    smooth = gaussian_filter(raster.values, separation_mm / 4 / raster.pitch_mm)
    apart = max(round(separation_mm / raster.pitch_mm / 2), 1)
    joined = _measure.label(keep, connectivity=1)
    peaks = _feature.peak_local_max(smooth, min_distance=apart, labels=joined, exclude_border=False)
    markers = np.zeros(keep.shape, dtype=np.int64)
    markers[tuple(peaks.T)] = np.arange(1, len(peaks) + 1)
    return _regions(raster, _segmentation.watershed(-smooth, markers, mask=keep))


def outlines(raster: Raster, level: float) -> tuple[NDArray[np.float64], ...]:
    """Closed outlines at a level, with sub-pixel accuracy (marching squares), longest first.

    The raster is continued with zeros, so that a region on its rim is closed too.

    Returns
    -------
    tuple of (k, 2) float64 [mm], first and last point equal.
    """
    found = _measure.find_contours(np.pad(raster.values, 1), level)
    closed = [raster.places_mm(contour - 1) for contour in found]
    return tuple(sorted(closed, key=lambda outline: -float(_lengths(outline).sum())))


def outline_area_mm2(outline: NDArray[np.float64]) -> float:
    """Area inside a closed outline."""
    start, end = outline[:-1], outline[1:]
    return abs(float((start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]).sum())) / 2


def outline_overlap_percent(outline: NDArray[np.float64], x_mm: float, y_mm: float, radius_mm: float) -> float:
    """A_OL of the region inside a closed outline, exact to the circle's arc (paper Eq 5)."""
    around = outline - np.array([x_mm, y_mm])
    inside = abs(float(area_under_edges(around[:-1], around[1:], radius_mm).sum()))
    return 50.0 * inside * (1 / (np.pi * radius_mm**2) + 1 / outline_area_mm2(outline))


def outline_deviation_mm2(outline: NDArray[np.float64], x_mm: float, y_mm: float, radius_mm: float) -> float:
    """SD of a closed outline, length-weighted (paper Eq 6)."""
    around = outline - np.array([x_mm, y_mm])
    length = _lengths(outline)
    edges = length > 0
    integral = squared_deviation_integral(around[:-1][edges], around[1:][edges], length[edges], radius_mm)
    return float(integral.sum() / length.sum())


def _lengths(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    lengths: NDArray[np.float64] = np.hypot(*np.diff(outline, axis=0).T)
    return lengths


def _regions(raster: Raster, labels: NDArray[np.int64]) -> tuple[Region, ...]:
    pixel_mm2 = raster.pitch_mm**2
    regions = []
    for found in _measure.regionprops(labels, intensity_image=raster.values):
        pixels = labels == found.label
        centre = raster.places_mm(np.array([found.centroid_weighted]))[0]
        weight = float(raster.values[pixels].sum()) * pixel_mm2
        regions.append(Region(pixels, centre, float(found.num_pixels) * pixel_mm2, weight))
    return tuple(sorted(regions, key=lambda region: -region.weight_mm2))
