"""What a parameter is chosen on: a small central target, and changes measured or made up, with their noise."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.reconstruction import ImagingProblem
from cbsr_qa.reconstruct.folding import ReadingFold
from cbsr_qa.reconstruct.problem import target_signal

Array = NDArray[np.float64]

#: Radius of the central target, of the sheet's: the 13 mm indenter on the 100 mm disc.
TARGET_RADIUS: Final = 0.13
#: Its contrast for a noise figure, where the response is still linear.
SMALL_CONTRAST: Final = 0.01

# Where nothing was measured: a press as deep as the paper's, the noise of a good instrument.
_CONTRAST: Final = 0.2
_NOISE_DB: Final = 60
_FRAMES: Final = 32
_SEED: Final = 3

_MOST_CHANGED: Final = 1e12  # a measured change, of the largest reading: more is another unit


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Changes to choose a parameter from.

    Parameters
    ----------
    changes : (n, m) float64, scaled as the problem's reference.
    variance : of a reading of unit relative variance; None where nobody knows.
    words : what they are.
    """

    changes: Array
    variance: float | None
    words: str


def target_radius_mm(problem: ImagingProblem) -> float:
    """Radius of the central target on a sheet [mm]."""
    return TARGET_RADIUS * problem.sensor_type.radius_mm


def central_signal(problem: ImagingProblem, contrast: float = SMALL_CONTRAST) -> Array:
    """Changes of the used readings for the central target, (m,)."""
    x, y = problem.sensor_type.outline.centre_mm
    return target_signal(problem, x_mm=x, y_mm=y, radius_mm=target_radius_mm(problem), contrast=contrast)


def evidence_of(problem: ImagingProblem) -> Evidence:
    """Return a problem's measured changes, with the noise that reciprocal readings show; else simulated ones.

    Raises
    ------
    NumericsError
        If the sample does not fit the problem, is not finite, or is of another unit.
    """
    return _simulated(problem) if problem.sample is None else _measured(problem, problem.sample)


def _measured(problem: ImagingProblem, sample: Array) -> Evidence:
    count = len(problem.reference)
    if sample.ndim != 2 or sample.shape[1] != count or not len(sample):
        raise NumericsError(
            f"a sample of shape {sample.shape} does not fit {count} used readings",
            remedy=f"give frames of the used readings, (k, {count})",
        )
    if not np.isfinite(sample).all():
        raise NumericsError("a reading to choose λ from is not a finite number", remedy="leave its channel out")
    largest, usual = float(np.abs(sample).max()), float(np.abs(problem.reference).max())
    if largest > _MOST_CHANGED * usual:
        raise NumericsError(
            f"a change to choose λ from is {largest:.2g}, where readings are {usual:.2g}: at most"
            f" {_MOST_CHANGED:.0e} times as much can be",
            remedy="give changes in the unit of the reference readings",
        )
    variance, freedom = ReadingFold.of(problem).noise(sample)
    frames = "1 measured change" if len(sample) == 1 else f"{len(sample)} measured changes"
    return Evidence(sample, variance if freedom else None, frames)


def _simulated(problem: ImagingProblem) -> Evidence:
    deviation = 10 ** (-_NOISE_DB / 20) * float(np.abs(problem.reference).mean())
    relative = np.ones(len(problem.reference)) if problem.noise_variance is None else problem.noise_variance
    noise = np.random.default_rng(_SEED).standard_normal((_FRAMES, len(relative))) * np.sqrt(relative)
    words = (
        f"{_FRAMES} simulated frames (seed {_SEED}) of a central target of {2 * target_radius_mm(problem):.3g} mm and"
        f" {_CONTRAST:.0%} contrast, noise {_NOISE_DB} dB below the mean reading"
    )
    return Evidence(central_signal(problem, _CONTRAST) + deviation * noise, deviation**2, words)
