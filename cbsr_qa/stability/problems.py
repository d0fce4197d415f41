"""The usual sensor as a linear problem, whole and with what makes it hard, and the methods that are installed."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.patterns import adjacent_pattern
from cbsr_qa.domain.reconstruction import ImagingProblem, PreparedReconstruction
from cbsr_qa.domain.sensor import Response, SensorType
from cbsr_qa.hookspecs import Kind
from cbsr_qa.plugins import Plugins, discover
from cbsr_qa.reconstruct.problem import imaging_problem

IMAGE_MM: Final = 6.0


def usual_sensor() -> SensorType:
    """The 100 mm disc with sixteen pins, adjacent drives and measurements."""
    layout = ElectrodeLayout(16, ElectrodeKind.PIN, 48.0, 0.65, 0.0, counterclockwise=True)
    return SensorType("stability", 50.0, 4.0, layout, adjacent_pattern(16), Response.AUTO)


@lru_cache(maxsize=1)
def _plugins() -> Plugins:
    return discover()


def prepared(name: str, problem: ImagingProblem, options: Mapping[str, Any]) -> PreparedReconstruction:
    """Prepare a method that is installed, as ``analyse`` does."""
    method: PreparedReconstruction = _plugins().factory(Kind.RECONSTRUCTION, name)(**options).prepare(problem)
    return method


@lru_cache(maxsize=4)
def usual_problem(kind: str = "whole") -> ImagingProblem:
    """The usual sensor on a coarse image; with three electrodes masked, or noise over twelve decades."""
    sensor = usual_sensor()
    whole = imaging_problem(sensor, image_size_mm=IMAGE_MM)
    if kind == "masked":
        return imaging_problem(sensor, used=without_electrodes(sensor, (2, 7, 12)), image_size_mm=IMAGE_MM)
    if kind == "noisy":
        decades = np.random.default_rng(20261122).permutation(np.linspace(-6, 6, len(whole.reference)))
        return imaging_problem(sensor, noise_variance=0.9 * 10**decades, image_size_mm=IMAGE_MM)
    return whole


def without_electrodes(sensor: SensorType, electrodes: tuple[int, ...]) -> NDArray[np.bool_]:
    """Readings (drives, measures) that touch none of some electrodes."""
    pattern, chosen = sensor.pattern, list(electrodes)
    drives = (pattern.drive_currents()[chosen] != 0).any(axis=0)
    measures = (pattern.measure_matrix()[chosen] != 0).any(axis=0)
    return np.asarray(pattern.usable() & ~drives[:, None] & ~measures, dtype=np.bool_)
