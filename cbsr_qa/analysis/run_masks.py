"""Percentage masks of one image: the blobs each leaves, and the one that was sensed."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.footprints import Footprint
from cbsr_qa.domain.image import Blob, Image, Region
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.observation import MaskView
from cbsr_qa.domain.plan import AnalysisSettings
from cbsr_qa.imaging.blobs import AnyRegion, masked_blobs, nearest_blob
from cbsr_qa.imaging.contours import masked_contours
from cbsr_qa.imaging.noise_floor import floored
from cbsr_qa.imaging.several_loads import assign_regions

#: Values below this are rounding, not signal, whatever the noise floor: without it a noiseless simulation would
#: find blobs in the last digits.
RESOLUTION = 1e-9


def mask_views(
    mesh: Mesh,
    signed: NDArray[np.float64],
    noise_floor: float,
    settings: AnalysisSettings,
    pressed: Footprint,
    others: Sequence[Footprint] = (),
) -> tuple[MaskView, ...]:
    """Apply every percentage mask of the recipe to one response-signed image.

    Parameters
    ----------
    signed : (e,) float64, positive where the load shows, noise floor not subtracted.
    noise_floor : relative.
    pressed : the load.
    others : loads that were held at the same time.

    Returns
    -------
    One view per mask, in the recipe's order; views without blobs where nothing stands above the floor.
    """
    image = _cleared(mesh, signed, noise_floor)
    blobs = masked_blobs(image, settings.masks)
    outlined: Sequence[Sequence[Region]] = blobs
    if settings.outline == "contour":
        outlined = masked_contours(image, settings.masks)
    views = []
    for fraction, found, regions in zip(settings.masks, blobs, outlined, strict=True):
        region, fate = _sensed(regions, pressed, others)
        contour = None if isinstance(region, Blob) else region
        views.append(MaskView(fraction, found, _sensed(found, pressed, others)[0], contour, fate, len(regions)))
    return tuple(views)


def sensed_regions(
    mesh: Mesh,
    signed: NDArray[np.float64],
    noise_floor: float,
    settings: AnalysisSettings,
    pressed: Footprint,
    others: Sequence[Footprint] = (),
) -> list[Region | None]:
    """Return :attr:`MaskView.region` of every mask alone, for half the time."""
    image = _cleared(mesh, signed, noise_floor)
    found: Sequence[Sequence[Region]] = (
        masked_contours(image, settings.masks)
        if settings.outline == "contour"
        else masked_blobs(image, settings.masks)
    )
    return [_sensed(regions, pressed, others)[0] for regions in found]


def _sensed(
    regions: Sequence[AnyRegion], pressed: Footprint, others: Sequence[Footprint]
) -> tuple[AnyRegion | None, str]:
    """Return the region of a load, and what became of it: ``"apart"``, ``"merged"`` or ``"missed"``.

    A load alone has the nearest region, however far. Several held at once have those assigned to them, a head's
    diameter (that of its area) away at most.
    """
    if not others:
        nearest = nearest_blob(regions, *pressed.centre_mm)
        return nearest, "missed" if nearest is None else "apart"
    diameter_mm = 2 * float(np.sqrt(pressed.area_mm2 / np.pi))
    assignment = assign_regions(regions, [pressed, *others], gate_mm=diameter_mm)
    own = assignment.region_of[0]
    return None if own is None else regions[own], assignment.fate(0)


def _cleared(mesh: Mesh, signed: NDArray[np.float64], noise_floor: float) -> Image:
    return Image(mesh, floored(signed, max(noise_floor, RESOLUTION)))
