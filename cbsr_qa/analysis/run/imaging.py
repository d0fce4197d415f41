"""Conductance images of a run relative to its reference, percentage masks, and the sign of the response."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain.geometry.footprints import Footprint
from cbsr_qa.domain.imaging import Blob, Image, LinearReconstruction, Region
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.readings.frames import FrameBlock
from cbsr_qa.domain.results.observation import MaskView
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.sensor_type import Response
from cbsr_qa.eit.imaging.blobs import AnyRegion, find_blobs_by_mask, nearest_blob, subtract_noise_floor
from cbsr_qa.eit.imaging.contours import find_contours_by_mask
from cbsr_qa.eit.imaging.multi_load import assign_regions
from cbsr_qa.eit.inverse.scaling import changes


@dataclass(frozen=True, slots=True, eq=False)
class Imager:
    """A reconstruction with its reference frame.

    Parameters
    ----------
    reconstruction : the prepared matrix.
    reference : (drives, measures) float64 V, the unloaded frame.
    scale : sensor relative to the unit model, see :class:`~cbsr_qa.domain.imaging.LinearReconstruction`.
    """

    reconstruction: LinearReconstruction
    reference: Array
    scale: float

    @property
    def mesh(self) -> Mesh:
        return self.reconstruction.problem.mesh

    def images(self, frames: FrameBlock) -> Array:
        """Image n frames as one matrix product: (n, elements) float64, relative conductance change."""
        readings = changes(frames.voltages, self.reference, self.reconstruction.problem, self.scale)
        return self.reconstruction.images(readings)


#: A load votes only if its mean change under the head is this many noise floors: the floor is a maximum over
#: thousands of elements, so a third of it clearly exceeds the noise of a mean.
_VOTE = 1 / 3


def decide_response(
    configured: Response, signals: Iterable[float], noise_floor: float
) -> tuple[Response, str, tuple[str, ...]]:
    """Decide the sign of the response.

    Parameters
    ----------
    configured : response of the sensor type.
    signals : mean relative change under the head, one per load.
    noise_floor : relative.

    Returns
    -------
    INCREASE or DECREASE, the basis of the decision, and warnings (loads that disagree, or none clear enough).
    """
    clear_signals = [signal for signal in signals if abs(signal) > _VOTE * noise_floor]
    rising = sum(signal > 0 for signal in clear_signals)
    falling = len(clear_signals) - rising
    voted = Response.INCREASE if rising >= falling else Response.DECREASE
    counts_text = f"{rising} loads raise the conductance, {falling} lower it"
    if configured is not Response.AUTO:
        against = f"the sensor type sets its response to {configured}, but {counts_text}"
        disagree = bool(clear_signals) and voted is not configured
        return configured, "configured in the sensor type", (against,) if disagree else ()
    if not clear_signals:
        return voted, "not decided: no load stands out of the noise", ("no load stands out of the noise",)
    warnings = (f"the loads disagree on the sign of the response: {counts_text}",) if rising and falling else ()
    return voted, f"decided from {len(clear_signals)} loads: {counts_text}", warnings


def mean_under(mesh: Mesh, values: Array, pressed: Footprint) -> float:
    """Area-weighted mean of an image (e,) over the elements with their centroid under a head; 0 without any."""
    under_mask = pressed.contains(mesh.centroids_mm)
    area = mesh.areas_mm2 * under_mask
    return float(values @ area / area.sum()) if under_mask.any() else 0.0


#: Smaller values are rounding, whatever the noise floor: otherwise a noiseless simulation would have blobs in the
#: last digits.
RESOLUTION = 1e-9


def mask_views(
    mesh: Mesh,
    signed: Array,
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
    others : loads held at the same time.

    Returns
    -------
    One view per mask, in the recipe's order; views without blobs if nothing exceeds the floor.
    """
    image = _clear_noise(mesh, signed, noise_floor)
    blobs = find_blobs_by_mask(image, settings.masks)
    outlined = _outline_regions(image, settings) if settings.outline == "contour" else blobs
    views = []
    for fraction, mask_blobs, regions in zip(settings.masks, blobs, outlined, strict=True):
        region, fate = _match_region(regions, pressed, others)
        contour = None if isinstance(region, Blob) else region
        views.append(
            MaskView(fraction, mask_blobs, _match_region(mask_blobs, pressed, others)[0], contour, fate, len(regions))
        )
    return tuple(views)


def find_sensed_regions(
    mesh: Mesh,
    signed: Array,
    noise_floor: float,
    settings: AnalysisSettings,
    pressed: Footprint,
    others: Sequence[Footprint] = (),
) -> list[Region | None]:
    """Return :attr:`MaskView.region` of every mask alone, for half the time."""
    outlined = _outline_regions(_clear_noise(mesh, signed, noise_floor), settings)
    return [_match_region(regions, pressed, others)[0] for regions in outlined]


def _outline_regions(image: Image, settings: AnalysisSettings) -> Sequence[Sequence[Region]]:
    return (find_contours_by_mask if settings.outline == "contour" else find_blobs_by_mask)(image, settings.masks)


def _match_region(
    regions: Sequence[AnyRegion], pressed: Footprint, others: Sequence[Footprint]
) -> tuple[AnyRegion | None, str]:
    """Return the region of a load, and its fate: ``"apart"``, ``"merged"`` or ``"missed"``.

    A load alone has the nearest region, however far. Several simultaneous loads have those assigned to them, at most
    a head's diameter (that of its area) away.
    """
    if not others:
        nearest = nearest_blob(regions, *pressed.centre_mm)
        return nearest, "missed" if nearest is None else "apart"
    diameter_mm = 2 * float(np.sqrt(pressed.area_mm2 / np.pi))
    assignment = assign_regions(regions, [pressed, *others], gate_mm=diameter_mm)
    own_region = assignment.region_of[0]
    return None if own_region is None else regions[own_region], assignment.name_outcome(0)


def _clear_noise(mesh: Mesh, signed: Array, noise_floor: float) -> Image:
    return Image(mesh, subtract_noise_floor(signed, max(noise_floor, RESOLUTION)))
