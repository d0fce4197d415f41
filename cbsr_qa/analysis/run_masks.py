"""Percentage masks of one image: the blobs each leaves, and the one that was sensed."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.image import Image
from cbsr_qa.domain.loads import Load
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.observation import MaskView
from cbsr_qa.domain.plan import AnalysisSettings
from cbsr_qa.imaging.blobs import masked_blobs, nearest_blob
from cbsr_qa.imaging.noise_floor import floored

#: Values below this are rounding, not signal, whatever the noise floor: without it a noiseless simulation would
#: find blobs in the last digits.
RESOLUTION = 1e-9


def mask_views(
    mesh: Mesh, signed: NDArray[np.float64], noise_floor: float, settings: AnalysisSettings, load: Load
) -> tuple[MaskView, ...]:
    """Apply every percentage mask of the recipe to one response-signed image.

    Parameters
    ----------
    signed : (e,) float64, positive where the load shows, noise floor not subtracted.
    noise_floor : relative.
    load : the sensed blob is the one nearest to it.

    Returns
    -------
    One view per mask, in the recipe's order; views without blobs where nothing stands above the floor.
    """
    image = Image(mesh, floored(signed, max(noise_floor, RESOLUTION)))
    return tuple(
        MaskView(fraction, blobs, nearest_blob(blobs, load.x_mm, load.y_mm))
        for fraction, blobs in zip(settings.masks, masked_blobs(image, settings.masks), strict=True)
    )
