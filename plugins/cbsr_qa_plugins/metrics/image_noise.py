"""Noise of the unloaded images: the floor that masks subtract, and σ_n over time."""

from typing import Any, ClassVar

import numpy as np

from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa.reconstruct.scaling import changes
from cbsr_qa_plugins.metrics._shared import refuse_unknown


class ImageNoise:
    """``noise_floor`` and ``conductance_noise`` σ_n of the run, both relative conductance changes [1].

    σ_n is the standard deviation over time of the unloaded images: without qualifier of their area-weighted mean,
    with ``"per element"`` the rms of the single elements'. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"noise_floor": "1", "conductance_noise": "1"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("image-noise", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; σ_n needs two unloaded frames."""
        frames = len(run.noise_images)
        floor = Measurement(
            "noise_floor", run.noise_floor, "1", how=f"largest |value| of any element in {frames} unloaded images"
        )
        return (floor, *_over_time(run))


def _over_time(run: RunObservation) -> tuple[Measurement, Measurement]:
    name, count = "conductance_noise", len(run.unloaded)
    if count < 2:
        why = f"{count} unloaded frames do not show a deviation over time; two are needed"
        return Measurement(name, None, "1", how=why), Measurement(name, None, "1", qualifier="per element", how=why)
    problem = run.reconstruction.problem
    images = run.reconstruction.images(changes(run.unloaded.voltages, run.reference, problem, run.scale))
    weights = problem.mesh.areas_mm2 / problem.mesh.areas_mm2.sum()
    total = float((images @ weights).std(ddof=1))
    single = float(np.sqrt(images.var(axis=0, ddof=1) @ weights))
    # Relative standard error of a standard deviation of normal noise.
    relative = 1 / np.sqrt(2 * (count - 1))
    how = f"standard deviation over {count} unloaded frames"
    return (
        Measurement(name, total, "1", total * relative, how=f"{how} of the area-weighted mean image"),
        Measurement(name, single, "1", single * relative, qualifier="per element", how=f"{how}, rms over the area"),
    )
