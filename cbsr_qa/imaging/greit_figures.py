"""The figures of merit of Adler et al. 2009 (Physiol. Meas. 30 S35), area-weighted and exact on a mesh."""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.footprints import Footprint, RoundFootprint, overlap_mm2
from cbsr_qa.domain.image import Image
from cbsr_qa.imaging.masks import threshold

#: The set q holds what reaches this share of the maximum; Adler et al. take a quarter.
QUARTER = 0.25


@dataclass(frozen=True, slots=True)
class GreitFigures:
    """Figures of one image of one target.

    Parameters
    ----------
    amplitude_response : AR, integral of the image over that of the target; None where its contrast is not known.
    position_error_mm : PE = r_t − r_q, positive where the image is nearer to the sheet's centre than the target.
    resolution : RES = √(A_q/A_0), of the area of the sheet.
    shape_deformation : SD, share of q outside a circle of its area about its centre.
    ringing : RNG, integral of the opposite sign outside that circle over the integral within it; None where that is
        not positive (a set q in several pieces, with nothing between them).
    """

    amplitude_response: float | None
    position_error_mm: float
    resolution: float
    shape_deformation: float
    ringing: float | None


def greit_figures(
    image: Image, target: Footprint, *, contrast: float | None = None, fraction: float = QUARTER
) -> GreitFigures | None:
    """Measure an image of one target.

    The set q and the circle are taken over the whole image, as Adler et al. do: a second blob in q deforms the shape.
    Elements that the circle cuts count with the share it cuts off, where the paper counts pixels. The centre of q is
    that of its area, without weights. A raster is measured as :func:`~cbsr_qa.imaging.rasters.pixel_image`.

    Parameters
    ----------
    image : turned so that the target is positive; nothing subtracted, since ringing is what is negative.
    target : where it was.
    contrast : relative conductance change of the target, of the sign of the image; for AR.
    fraction : of the maximum, for q.

    Returns
    -------
    GreitFigures; None for an image without a positive element.

    Raises
    ------
    NumericsError
        If the fraction is outside (0, 1], or the contrast not positive.
    """
    if not 0 < fraction <= 1:
        raise NumericsError(f"a set of what reaches {fraction:g} of the maximum is outside (0, 1]")
    if contrast is not None and not contrast > 0:
        raise NumericsError(f"a contrast of {contrast:g} is not positive", remedy="turn image and contrast round")
    mesh, values = image.mesh, image.values
    if values.max() <= 0:
        return None
    kept = values >= threshold(values, fraction)
    area = float(mesh.areas_mm2[kept].sum())
    centre = mesh.areas_mm2[kept] @ mesh.centroids_mm[kept] / area
    inside = overlap_mm2(RoundFootprint(float(centre[0]), float(centre[1]), np.sqrt(area / np.pi)), mesh.corners_mm)
    outside = np.maximum(mesh.areas_mm2 - inside, 0.0)
    within = float(values @ inside)
    integral = float(values @ mesh.areas_mm2)
    return GreitFigures(
        amplitude_response=None if contrast is None else integral / (contrast * target.area_mm2),
        position_error_mm=float(np.hypot(*target.centre_mm) - np.hypot(*centre)),
        resolution=float(np.sqrt(area / mesh.areas_mm2.sum())),
        shape_deformation=float(outside[kept].sum()) / area,
        ringing=float(np.maximum(-values, 0.0) @ outside) / within if within > 0 else None,
    )
