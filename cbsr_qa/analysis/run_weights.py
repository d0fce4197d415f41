"""How much each reading of a run counts in its images."""

import numpy as np

from cbsr_qa.analysis.run_reference import UsableData, named_readings
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.frames import FrameBlock
from cbsr_qa.domain.plan import AnalysisSettings
from cbsr_qa.domain.reconstruction import ImagingProblem
from cbsr_qa.interfaces import Reconstruction
from cbsr_qa.reconstruct.noise_weights import reading_noise
from cbsr_qa.reconstruct.problem import imaging_problem


def check_weighing(reconstruction: Reconstruction, method: str, settings: AnalysisSettings) -> None:
    """Make sure that a method weighs readings by their noise where the recipe asks for it.

    Parameters
    ----------
    method : its name, for the message.

    Raises
    ------
    NumericsError
        If it says that it does not.
    """
    if settings.noise_weighting == "measured" and not getattr(reconstruction, "weighs_noise", True):
        raise NumericsError(
            f'analysis.noise_weighting is "measured", but reconstruction {method!r} lets all readings count alike',
            remedy='take another method, or set analysis.noise_weighting = "equal" in the recipe',
        )


def weighed_problem(
    data: UsableData, unloaded: FrameBlock, settings: AnalysisSettings
) -> tuple[ImagingProblem, tuple[str, ...]]:
    """Linearise a run's sheet with the noise of its readings.

    Parameters
    ----------
    unloaded : frames of the rested sheet before the first press.
    settings : say whether readings are weighed by their noise in those, or alike.

    Returns
    -------
    The problem, and a warning where the noise of some readings is not known.

    Raises
    ------
    NumericsError
        If the readings' noise cannot be told from those frames (:func:`reading_noise`), or too few are usable.
    """
    sensor_type, used = data.record.sensor_type, data.readings
    if settings.noise_weighting == "equal":
        return imaging_problem(sensor_type, used=used), ()
    noise = reading_noise(unloaded.voltages[:, used], unloaded.time_s)
    problem = imaging_problem(sensor_type, used=used, noise_variance=noise.variance)
    if not noise.silent.any():
        return problem, ()
    silent = np.zeros_like(used)
    silent[used] = noise.silent
    words = (
        f"{int(silent.sum())} readings are the same in all {len(unloaded)} unloaded frames, so that nobody knows"
        f" their noise; they are weighed like a common one: {named_readings(silent)}"
    )
    return problem, (words,)
