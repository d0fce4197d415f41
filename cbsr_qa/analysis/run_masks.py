"""Percentage masks of one image: the blobs each leaves, and the one that was sensed."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.footprints import Footprint
from cbsr_qa.domain.image import Image, Region
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.observation import MaskView
from cbsr_qa.domain.plan import AnalysisSettings
from cbsr_qa.imaging.blobs import masked_blobs, nearest_blob
from cbsr_qa.imaging.contours import masked_contours
from cbsr_qa.imaging.noise_floor import floored

#: Values below this are rounding, not signal, whatever the noise floor: without it a noiseless simulation would
#: find blobs in the last digits.
RESOLUTION = 1e-9


def mask_views(
    mesh: Mesh, signed: NDArray[np.float64], noise_floor: float, settings: AnalysisSettings, pressed: Footprint
) -> tuple[MaskView, ...]:
    """Apply every percentage mask of the recipe to one response-signed image.

    Parameters
    ----------
    signed : (e,) float64, positive where the load shows, noise floor not subtracted.
    noise_floor : relative.
    pressed : the sensed blob is the one nearest to its centre.

    Returns
    -------
    One view per mask, in the recipe's order; views without blobs where nothing stands above the floor.
    """
    image = _cleared(mesh, signed, noise_floor)
    blobs = masked_blobs(image, settings.masks)
    contours: Sequence[Region | None] = (None,) * len(blobs)
    if settings.outline == "contour":
        contours = [nearest_blob(found, *pressed.centre_mm) for found in masked_contours(image, settings.masks)]
    return tuple(
        MaskView(fraction, found, nearest_blob(found, *pressed.centre_mm), contour)
        for fraction, found, contour in zip(settings.masks, blobs, contours, strict=True)
    )


def sensed_regions(
    mesh: Mesh, signed: NDArray[np.float64], noise_floor: float, settings: AnalysisSettings, pressed: Footprint
) -> list[Region | None]:
    """Return :attr:`MaskView.region` of every mask alone, for half the time."""
    image = _cleared(mesh, signed, noise_floor)
    find = masked_contours if settings.outline == "contour" else masked_blobs
    return [nearest_blob(found, *pressed.centre_mm) for found in find(image, settings.masks)]


def _cleared(mesh: Mesh, signed: NDArray[np.float64], noise_floor: float) -> Image:
    return Image(mesh, floored(signed, max(noise_floor, RESOLUTION)))
