"""Noise figure of a linear imaging matrix: input over output signal-to-noise ratio; and λ for a noise figure.

Parameters are chosen on a small central target, and on measured or simulated changes with their noise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from scipy.optimize import brentq

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.inverse.dual import DualSpectrum
from cbsr_qa.eit.inverse.problem import target_signal
from cbsr_qa.eit.inverse.readings import ReadingFold


class NoiseFigureForm(StrEnum):
    """Which of the two forms in use; a report names it."""

    ADLER_2009 = "Adler et al. 2009"  #: rms noise from the propagated covariance
    EIDORS = "EIDORS"  #: mean over channels of the deviation over elements, 2–20 % lower


def noise_figure(
    matrix: Array,
    signal: Array,
    areas: Array,
    *,
    noise_variance: Array | None = None,
    form: NoiseFigureForm = NoiseFigureForm.ADLER_2009,
) -> float:
    """NF = SNR of the readings over SNR of the image, each mean|signal| over rms noise.

    Parameters
    ----------
    matrix : (e, m) R.
    signal : (m,) y of a small central target.
    areas : (e,) weights A of the image, in any unit.
    noise_variance : (m,) variance of the readings, for the 2009 form only; None for equal noise on every channel.
    form : 2009: (mean|y| / √mean v) / (mean|A R y| / √(Σ(A R)² v / e)).
        EIDORS: noise on one channel c at a time, deviations with the mean removed over channels or elements and
        ddof 1, (mean|y| / mean_c std(n_c)) / (mean|A R y| / mean_c std(A R n_c)).

    Raises
    ------
    NumericsError
        If the image of the signal is zero, or variances are given for EIDORS's form, which has none.
    """
    weighted = areas[:, None] * matrix
    response = float(np.abs(weighted @ signal).mean())
    if not (np.isfinite(response) and response > 0):
        raise NumericsError(
            "the noise figure is not defined: the matrix does not respond to the target",
            remedy="check the hyperparameter and which channels are masked",
        )
    level = float(np.abs(signal).mean())
    if form is NoiseFigureForm.EIDORS:
        if noise_variance is not None:
            raise NumericsError(
                "the EIDORS form of the noise figure assumes equal noise on all readings",
                remedy="use the form of Adler et al. 2009",
            )
        channel = np.std(np.eye(len(signal))[0], ddof=1)
        return level / float(channel) * float(np.std(weighted, axis=0, ddof=1).mean()) / response
    variance = np.ones(len(signal)) if noise_variance is None else noise_variance
    noise = np.sqrt(np.einsum("em,em,m->", weighted, weighted, variance) / len(areas))
    return level / float(np.sqrt(variance.mean())) * float(noise) / response


#: Radius of the central target over the sheet's: the 13 mm indenter on the 100 mm disc.
TARGET_RADIUS: Final = 0.13
#: Contrast of that target for a noise figure, within the linear response.
SMALL_CONTRAST: Final = 0.01

#: Simulated evidence: contrast of a press as deep as the paper's, and noise of a good instrument [dB].
CONTRAST: Final = 0.2
NOISE_DB: Final = 60
_FRAMES: Final = 32
SEED: Final = 3

_MOST_CHANGED: Final = 1e12  # a measured change, of the largest reading: more indicates another unit


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Changes to choose a parameter from.

    Parameters
    ----------
    changes : (n, m) float64, scaled as the problem's reference.
    variance : variance of a reading of unit relative variance; None if unknown.
    words : description of them.
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
    """Return a problem's measured changes, with the noise shown by reciprocal readings; else simulated ones.

    NumericsError if the sample does not fit the problem, is not finite, or is of another unit.
    """
    return (
        simulate_evidence(problem, _FRAMES, _FRAMES)
        if problem.sample is None
        else _evidence_from_sample(problem, problem.sample)
    )


def _evidence_from_sample(problem: ImagingProblem, sample: Array) -> Evidence:
    count = len(problem.reference)
    if sample.ndim != 2 or sample.shape[1] != count or not len(sample):
        raise NumericsError(
            f"sample of shape {sample.shape} does not match {count} used readings",
            remedy=f"give frames of the used readings, (k, {count})",
        )
    if not np.isfinite(sample).all():
        raise NumericsError("a reading to choose λ from is not a finite number", remedy="leave its channel out")
    largest, usual = float(np.abs(sample).max()), float(np.abs(problem.reference).max())
    if largest > _MOST_CHANGED * usual:
        raise NumericsError(
            f"a change to choose λ from is {largest:.2g} and readings are {usual:.2g}; a change may be at most"
            f" {_MOST_CHANGED:.0e} times the readings",
            remedy="give changes in the unit of the reference readings",
        )
    variance, freedom = ReadingFold.from_problem(problem).noise(sample)
    frames = "1 measured change" if len(sample) == 1 else f"{len(sample)} measured changes"
    return Evidence(sample, variance if freedom else None, frames)


def simulate_evidence(problem: ImagingProblem, draws: int, frames: int) -> Evidence:
    """Changes for a central target in noise: a press as deep as the paper's, the noise of a good instrument.

    ``draws``: of noise; ``frames``: number used for the choice, for the description.
    """
    deviation = 10 ** (-NOISE_DB / 20) * float(np.abs(problem.reference).mean())
    relative = np.ones(len(problem.reference)) if problem.noise_variance is None else problem.noise_variance
    noise = np.random.default_rng(SEED).standard_normal((draws, len(relative))) * np.sqrt(relative)
    description = (
        f"{frames} simulated frames (seed {SEED}) of a central target of {2 * target_radius_mm(problem):.3g} mm and"
        f" {CONTRAST:.0%} contrast, noise {NOISE_DB} dB below the mean reading"
    )
    return Evidence(central_signal(problem, CONTRAST) + deviation * noise, deviation**2, description)


_LOWEST, _HIGHEST = 1e-6, 1e3  # λ searched, relative to the root of the largest eigenvalue
_STEPS: Final = 43


def noise_figure_of(
    spectrum: DualSpectrum, signal: Array, areas: Array, noise_variance: Array | None = None
) -> Callable[[float], float]:
    """Noise figure (Adler et al. 2009) as a function of λ, at a matrix–vector product a call.

    The rows of the analysis have unit variance and no covariance: Σ(A R)²v = Σ_k (Σ_e A_e²B_ek²) g_k².
    """
    basis = areas[:, None] * spectrum.basis
    energy = (basis**2).sum(axis=0)
    coefficients = spectrum.analysis @ signal
    variance = np.ones(len(signal)) if noise_variance is None else noise_variance
    snr = float(np.abs(signal).mean() / np.sqrt(variance.mean()))

    def figure(hyperparameter: float) -> float:
        gain = spectrum.gains(hyperparameter)
        noise = np.sqrt((energy * gain**2).sum() / len(areas))
        return snr * float(noise / np.abs(basis @ (gain * coefficients)).mean())

    return figure


def hyperparameter_for(
    target: float, spectrum: DualSpectrum, signal: Array, areas: Array, noise_variance: Array | None = None
) -> float:
    """Find λ, to ten digits, whose noise figure is the target.

    NumericsError if no λ reaches the target; names the possible range.
    """
    figure = noise_figure_of(spectrum, signal, areas, noise_variance)
    grid = np.log(search_grid(spectrum))
    reached_figures = np.array([figure(float(np.exp(at))) for at in grid])
    if not (np.isfinite(target) and reached_figures.min() <= target <= reached_figures.max()):
        raise NumericsError(
            f"noise figure {target} cannot be reached;"
            f" this sensor type allows {reached_figures.min():.3g} to {reached_figures.max():.3g}",
            remedy="give a noise figure in that range, or the hyperparameter itself",
        )
    # The noise figure falls with λ apart from wiggles at the ends; the largest λ that reaches the target is
    # smoothest.
    last = np.flatnonzero((reached_figures[:-1] >= target) & (target >= reached_figures[1:]))[-1]
    root = brentq(lambda at: np.log(figure(float(np.exp(at))) / target), grid[last], grid[last + 1], xtol=1e-12)
    return round_figure(float(np.exp(root)))


def round_figure(value: float) -> float:
    """Ten digits: those beyond depend on the number of threads."""
    return float(f"{value:.10g}")


def search_grid(spectrum: DualSpectrum) -> Array:
    """Rising values of λ to search."""
    unit = float(np.sqrt(spectrum.values[-1]))
    return np.geomspace(_LOWEST * unit, _HIGHEST * unit, _STEPS)
