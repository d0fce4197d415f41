"""Where images put the nine loads of simulated sensors, and how large they make them."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.footprints import Footprint
from cbsr_qa.domain.image import Image
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.reconstruction import PreparedReconstruction
from cbsr_qa.frontier.computer_readings import NOISE_FRAMES, SimulatedReadings
from cbsr_qa.frontier.point import Accuracy
from cbsr_qa.imaging.blobs import nearest_blob
from cbsr_qa.imaging.contours import contour_regions
from cbsr_qa.imaging.noise_floor import floored, noise_floor
from cbsr_qa.imaging.shape import spatial_figures
from cbsr_qa.reconstruct.scaling import changes, scale_of

Array = NDArray[np.float64]

_MASK: Final = 0.85  # the recipes' main mask
_ROUNDING: Final = 1e-9  # values below are no signal, however quiet the unloaded frames
#: Figures of merit: unit, and whether more is better.
_FIGURES: Final = {"E_CoM": ("mm", False), "A_OL": ("%", True), "SD": ("mm²", False)}


def figures_of_merit(prepared: PreparedReconstruction, readings: SimulatedReadings) -> dict[str, Accuracy]:
    """Return mean E_CoM, A_OL and SD over the nine places, and the share of loads that leave no blob.

    As a run of the shipped recipes does: changes against the mean of the reference frames, the noise floor of the
    unloaded images subtracted, the 85 % mask bounded by a contour, the region nearest to the head.

    Returns
    -------
    By name, with the standard error of the mean over sensors; ``missed`` always, the others where a load was seen.
    """
    seen = np.array([_sensor(prepared, readings, number) for number in range(len(readings.loaded))])
    figures = {"missed": _mean(np.isnan(seen[:, :, 0]).mean(axis=1), "1", more_is_better=False)}
    known = seen[~np.isnan(seen[:, :, 0]).all(axis=1)]
    for column, (name, (unit, more)) in enumerate(_FIGURES.items()):
        if len(known):
            figures[name] = _mean(np.nanmean(known[:, :, column], axis=1), unit, more_is_better=more)
    return figures


def sensor_changes(readings: SimulatedReadings, number: int, prepared: PreparedReconstruction) -> tuple[Array, Array]:
    """Scaled changes of one sensor's unloaded frames (k, m) and of its loads (n, m)."""
    problem = prepared.problem
    reference = readings.unloaded[number, NOISE_FRAMES:].mean(axis=0)
    scale = scale_of(reference, problem)
    quiet, loaded = readings.unloaded[number, :NOISE_FRAMES], readings.loaded[number]
    return changes(quiet, reference, problem, scale), changes(loaded, reference, problem, scale)


def _sensor(prepared: PreparedReconstruction, readings: SimulatedReadings, number: int) -> list[Array]:
    """Figures of each load of one sensor, (n, 3); not a number where it left no blob."""
    quiet, loaded = sensor_changes(readings, number, prepared)
    floor = max(noise_floor(prepared.images(quiet)), _ROUNDING)
    # One frame at a time, as on a rig: an image must not depend on the frames beside it.
    return [
        _load(prepared.images(change[None])[0], prepared.problem.mesh, head, floor)
        for change, head in zip(loaded, readings.heads, strict=True)
    ]


def _load(image: Array, mesh: Mesh, head: Footprint, floor: float) -> Array:
    regions = contour_regions(Image(mesh, floored(image, floor)), _MASK)
    (found,) = spatial_figures([nearest_blob(regions, *head.centre_mm)], head)
    if found is None:
        return np.full(len(_FIGURES), np.nan)
    return np.array([found.error_mm, found.overlap_percent, found.deviation_mm2])


def _mean(values: Array, unit: str, *, more_is_better: bool) -> Accuracy:
    """Mean over sensors with its standard error, which a single sensor does not tell."""
    count = len(values)
    stderr = float(values.std(ddof=1) / np.sqrt(count)) if count > 1 else None
    return Accuracy(float(values.mean()), stderr, unit, more_is_better)
