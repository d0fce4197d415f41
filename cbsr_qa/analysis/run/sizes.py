"""Size response: area of the masked region as a function of the load's area."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import RoundFootprint, overlap_mm2
from cbsr_qa.domain.imaging import Image, PreparedReconstruction
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.eit.imaging.blobs import nearest_blob
from cbsr_qa.eit.imaging.contours import contour_regions

#: Slope below which the response is flat: a target of twice the area then has a region less than 19 % larger.
FLAT: Final = 0.25
#: Diameters of the targets, relative to the head's: 8, 13 and 20 mm for the 13 mm head.
RELATIVE_DIAMETERS: Final = (8 / 13, 1.0, 20 / 13)
_OUT_RADII: Final = 0.6  # of the radius: 30 mm on the 100 mm disc, as the paper's outer locations
_CONTRAST: Final = 0.05
_HIGHEST_MASK: Final = 0.99  # a contour at the maximum itself encloses nothing


@dataclass(frozen=True, slots=True)
class SizeResponse:
    """Areas of regions against areas of round targets at one place.

    Parameters
    ----------
    diameters_mm : diameters of the targets, rising [mm].
    areas_mm2 : area of each one's region [mm²], or None.
    """

    place: str
    diameters_mm: tuple[float, ...]
    areas_mm2: tuple[float | None, ...]

    @property
    def slope(self) -> float | None:
        """Slope of the region's log area over the target's: 1 if proportional, 0 if the size makes no difference.

        Return None with fewer than two regions.
        """
        measured = [(d, a) for d, a in zip(self.diameters_mm, self.areas_mm2, strict=True) if a is not None]
        if len(measured) < 2:
            return None
        diameters, areas = np.array(measured).T
        return float(np.polyfit(2 * np.log(diameters), np.log(areas), 1)[0])

    @property
    def flat(self) -> bool:
        """Whether the region does not reflect the size of the load."""
        return self.slope is None or self.slope < FLAT


def size_response(
    prepared: PreparedReconstruction,
    *,
    head_diameter_mm: float,
    mask: float = 0.85,
) -> tuple[SizeResponse, ...]:
    """Press targets of several sizes at the centre and 0.6 radii out, without noise, and measure the regions.

    The readings are those of the linearised model, so that the result depends only on the method and the problem.

    Parameters
    ----------
    head_diameter_mm : diameter of the indenter [mm]; targets have :data:`RELATIVE_DIAMETERS` of it.
    mask : fraction of the image's maximum, below 1; regions are bounded by its contour.

    Returns
    -------
    One for each place where the largest target lies fully on the sheet.

    Raises
    ------
    NumericsError
        If the diameter is not positive, or the largest target does not fit the sheet.
    """
    if not head_diameter_mm > 0:
        raise NumericsError(f"a size response needs a head of a positive diameter, not {head_diameter_mm:g} mm")
    diameters = tuple(head_diameter_mm * relative for relative in RELATIVE_DIAMETERS)
    problem = prepared.problem
    centre, out_mm = problem.sensor_type.outline.centre_mm, _OUT_RADII * problem.sensor_type.radius_mm
    places = (("centre", centre), (f"{out_mm:.3g} mm out", (centre[0] + out_mm, centre[1])))
    responses = []
    for place_words, place in places:
        largest = RoundFootprint(*place, diameters[-1] / 2)
        if float(overlap_mm2(largest, problem.mesh.corners_mm).sum()) > 0.99 * largest.area_mm2:
            areas = tuple(_measure_area(prepared, place, diameter, mask) for diameter in diameters)
            responses.append(SizeResponse(place_words, diameters, areas))
    if not responses:
        raise NumericsError(
            f"a target of {diameters[-1]:.3g} mm fits neither the centre of the sheet nor 0.6 radii out"
        )
    return tuple(responses)


def size_response_of(run: RunObservation) -> tuple[SizeResponse, ...]:
    """Size response of a run's reconstruction at its main mask; NumericsError if no target fits the sheet."""
    mask = min(run.main_mask, _HIGHEST_MASK)
    return size_response(run.reconstruction, head_diameter_mm=run.record.indenter.diameter_mm, mask=mask)


def _measure_area(
    prepared: PreparedReconstruction, place: tuple[float, float], diameter_mm: float, mask: float
) -> float | None:
    problem = prepared.problem
    share = overlap_mm2(RoundFootprint(*place, diameter_mm / 2), problem.mesh.corners_mm) / problem.mesh.areas_mm2
    image = prepared.images((problem.jacobian @ (_CONTRAST * share))[None])[0]
    region = nearest_blob(contour_regions(Image(problem.mesh, image), mask), *place)
    return None if region is None else region.area_mm2
