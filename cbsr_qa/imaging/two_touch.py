"""Two-touch resolution: how far apart two equal loads must be to be seen as two."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.footprints import Footprint, overlap_mm2
from cbsr_qa.domain.image import Image, Region
from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.reconstruction import ImagingProblem, PreparedReconstruction
from cbsr_qa.imaging.blobs import masked_blobs
from cbsr_qa.imaging.contours import contour_regions
from cbsr_qa.imaging.several_loads import Assignment, assign_regions
from cbsr_qa.imaging.watershed import split_blobs

Array = NDArray[np.float64]

#: Mask under which a watershed parts two loads, and how deep the valley between them must be, both of the maximum.
WATERSHED_MASK: Final = 0.25
WATERSHED_DEPTH: Final = 0.05


@dataclass(frozen=True, slots=True)
class TwoTouch:
    """Two equal loads, moved apart step by step.

    Parameters
    ----------
    separation_mm : smallest distance of their centres from which on they were two at every larger one; None where
        they were not two at the largest.
    tried_mm : the largest distance that was tried.
    step_mm : between distances.
    """

    separation_mm: float | None
    tried_mm: float
    step_mm: float


def two_touch_resolution(
    reconstruction: PreparedReconstruction,
    indenter: Indenter,
    *,
    mask: float | None = 0.85,
    direction_deg: float = 0.0,
    furthest_mm: float | None = None,
    step_mm: float = 0.5,
) -> TwoTouch:
    """Move two equal loads apart along a line through the sheet's centre until they are seen as two for good.

    They are two where :func:`~cbsr_qa.imaging.several_loads.assign_regions` finds a region for each that is nearer to
    it than to the other. The readings are those of the linearised model, without noise: the figure says what the
    method can part, not what a noisy frame lets it. Heads cannot overlap, so none is smaller than the head is wide.

    Parameters
    ----------
    mask : of the image's maximum, whose contours are counted; None for a watershed of the 25 % mask that parts peaks
        with a valley of 5 % between them.
    direction_deg : of the line.
    furthest_mm : largest distance of the centres; by default 0.8 of the sheet's radius.

    Raises
    ------
    NumericsError
        If the step is not positive, or the heads do not fit the distance.
    """
    problem = reconstruction.problem
    furthest_mm = 0.8 * problem.sensor_type.radius_mm if furthest_mm is None else furthest_mm
    angle = np.radians(direction_deg)
    along = np.array([np.cos(angle), np.sin(angle)])
    width = float(np.ptp(indenter.at(0.0, 0.0).drawn_mm() @ along))
    if not (step_mm > 0 and width + step_mm <= furthest_mm):
        raise NumericsError(
            f"two heads {width:.3g} mm wide do not move apart up to {furthest_mm:.3g} mm in steps of {step_mm:g} mm",
            remedy="try larger distances, in positive steps",
        )
    tried = step_mm * np.arange(np.ceil(width / step_mm), np.floor(furthest_mm / step_mm + 1e-9) + 1)
    seen = [_pair(reconstruction, indenter, along * distance / 2, mask).apart for distance in tried]
    together = np.flatnonzero(~np.array(seen))
    first = int(together[-1]) + 1 if together.size else 0
    return TwoTouch(float(tried[first]) if first < len(tried) else None, float(tried[-1]), step_mm)


def loads_change(problem: ImagingProblem, loads: list[Footprint]) -> Array:
    """Return the readings' changes (m,) of equal loads of contrast 1, by the linearised model."""
    shares = [overlap_mm2(load, problem.mesh.corners_mm) / problem.mesh.areas_mm2 for load in loads]
    change: Array = problem.jacobian @ np.sum(shares, axis=0)
    return change


def _pair(reconstruction: PreparedReconstruction, indenter: Indenter, half: Array, mask: float | None) -> Assignment:
    loads = [indenter.at(float(x), float(y)) for x, y in (half, -half)]
    values = reconstruction.images(loads_change(reconstruction.problem, loads)[None])[0]
    image = Image(reconstruction.problem.mesh, np.maximum(values, 0.0))
    regions: tuple[Region, ...]
    if mask is None:
        regions = split_blobs(masked_blobs(image, (WATERSHED_MASK,))[0], WATERSHED_DEPTH)
    else:
        regions = contour_regions(image, mask)
    return assign_regions(regions, loads, gate_mm=float(np.hypot(*half)))
