"""Total-variation reconstruction, frame by frame.

α is chosen to leave a residual as large as the noise (Morozov 1966). As ∫|∇x| does not depend on the mesh, α is
chosen on a coarse image of the sensor type.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.optimize import brentq

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem, ParameterChoice, check_readings
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.inverse.iterative.total_variation import TotalVariation, TvImage
from cbsr_qa.eit.inverse.noise_figures import (
    CONTRAST,
    NOISE_DB,
    SEED,
    Evidence,
    central_signal,
    evidence_of,
    simulate_evidence,
)
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.readings import ReadingFold

_UNEXPLAINED = 10.0  # residual over noise; loads that double the conductance leave 1.2, a tank's third dimension 5


@dataclass(frozen=True, slots=True, eq=False)
class WhiteReadings:
    """Readings of a problem, folded by reciprocity and with equal noise on all.

    Parameters
    ----------
    deviation : (g,) relative deviation of the folded readings.
    rows : (g, e), the Jacobian of white readings.
    """

    fold: ReadingFold
    deviation: Array
    rows: Array

    @classmethod
    def from_problem(cls, problem: ImagingProblem) -> "WhiteReadings":
        fold = ReadingFold.from_problem(problem)
        deviation = np.sqrt(fold.variance)
        return cls(fold, deviation, fold.rows(problem.jacobian) / deviation[:, None])

    def white(self, changes: Array) -> Array:
        """White readings (n, g) of changes (n, m)."""
        return self.fold.fold(changes) / self.deviation


@dataclass(frozen=True, slots=True, eq=False)
class TotalVariationImages:
    """A prepared method, see :class:`~cbsr_qa.domain.imaging.PreparedReconstruction`.

    Parameters
    ----------
    choice : choice of α.
    minimise : prepared for the problem's mesh and readings.
    variance : noise that α was chosen for, of a reading of unit relative variance; None if unknown.
    """

    method: str
    problem: ImagingProblem
    choice: ParameterChoice
    readings: WhiteReadings
    minimise: TotalVariation
    variance: float | None = None

    @classmethod
    def from_problem(
        cls,
        method: str,
        problem: ImagingProblem,
        choice: ParameterChoice,
        variance: float | None = None,
        *,
        tolerance: float,
        most_steps: int,
    ) -> "TotalVariationImages":
        """Prepare for a problem; tolerance and steps as for :class:`TotalVariation`."""
        readings = WhiteReadings.from_problem(problem)
        minimise = TotalVariation(problem.mesh, readings.rows, tolerance=tolerance, most_steps=most_steps)
        return cls(method, problem, choice, readings, minimise, variance)

    def images(self, changes: Array) -> Array:
        """Images (n, e) of scaled changes (n, m), each frame by itself.

        Raises
        ------
        RefusedError
            If readings do not fit or are not finite.
        NumericsError
            If a frame does not converge, or no image explains it within ten times the noise that α was chosen for.
        """
        return np.array([minimiser.image for minimiser in self.minimisers(changes)]).reshape(
            len(changes), len(self.problem.mesh.elements)
        )

    def minimisers(self, changes: Array) -> list[TvImage]:
        """Images with their residual, duality gap and number of steps."""
        white = self.readings.white(check_readings(changes, self.problem))
        images = [self.minimise.image(frame, self.choice.value) for frame in white]
        if self.variance is not None:
            ratios = np.sqrt([image.residual / (white.shape[1] * self.variance) for image in images])
            for frame in np.flatnonzero(ratios > _UNEXPLAINED)[:1]:
                raise NumericsError(
                    f"no image explains frame {frame}: the residual is {ratios[frame]:.0f} times the expected noise",
                    remedy="set noise_dB to the noise of the readings, or check geometry and channels",
                )
        return images


_COARSE: Final = 0.12  # edge length of the image used to choose α, of the sheet's radius
_SAID: Final = "residual as large as the noise (discrepancy principle) on "
_FRAMES: Final = 3  # frames over which a residual is averaged
_DRAWS: Final = 8  # of noise, for the noise figure
_LEAST: Final = 1e-7  # α searched, relative to the one that leaves only a flat image
_NOTHING: Final = 1e-12  # of the largest reading: less is not a change
_STEP: Final = 8.0  # factor of the downward search
_CLEAR: Final = 4.0  # sampling errors by which a flat image must be rejected; otherwise the readings are all noise
_EXACT: Final = 0.01  # α to a hundredth: the target residual is no better known


def choose_alpha(
    problem: ImagingProblem, *, given: float | None, noise_dB: float
) -> tuple[ParameterChoice, float | None]:
    """Choose α for a problem, with the variance of a reading of unit relative variance it was made for.

    Parameters
    ----------
    given : α itself, without a variance; None for the discrepancy principle, on the problem's measured changes, or
        else on simulated ones of the sensor type's nominal problem.
    noise_dB : noise below the mean reading without measured changes; α is proportional to the noise.

    Raises
    ------
    NumericsError
        If no α leaves a residual as large as the noise.
    """
    if problem.sample is not None:
        return _choose_alpha(problem, given, noise_dB)
    return _choose_for_type(problem.sensor_type, given, noise_dB)


@lru_cache(maxsize=16)
def _choose_for_type(
    sensor_type: SensorType, given: float | None, noise_dB: float
) -> tuple[ParameterChoice, float | None]:
    return _choose_alpha(imaging_problem(sensor_type), given, noise_dB)


def _choose_alpha(
    problem: ImagingProblem, given: float | None, noise_dB: float
) -> tuple[ParameterChoice, float | None]:
    size_mm = _COARSE * problem.sensor_type.radius_mm
    coarse = imaging_problem(
        problem.sensor_type, used=problem.used, noise_variance=problem.noise_variance, image_size_mm=size_mm
    )
    simulated = simulate_evidence(coarse, _DRAWS, _FRAMES)
    assert simulated.variance is not None
    noise_ratio = 10 ** ((NOISE_DB - noise_dB) / 20)
    looks = problem.sample is not None and given is None
    evidence = evidence_of(replace(coarse, sample=problem.sample)) if looks else simulated
    if given is not None:
        value, how, variance = given, "hyperparameter given", None
    elif looks:
        value, how, variance = _alpha_of_discrepancy(coarse, evidence), _SAID + evidence.words, evidence.variance
    else:
        value = float(f"{noise_ratio * _alpha_of_discrepancy(coarse, evidence):.6g}")
        how, variance = _SAID + evidence.words, noise_ratio**2 * simulated.variance
        how += "" if noise_ratio == 1 else f", times {noise_ratio:.3g} for noise of {noise_dB:g} dB"
    # Scaling target and noise scales the image: if α holds for one, factor · α holds for the other.
    figure, error = _noise_figure(coarse, value / noise_ratio, simulated)
    how += (
        f"; noise figure {figure:.2f} ± {error:.2f} by {_DRAWS} draws (seed {SEED}) at"
        f" {100 * noise_ratio * CONTRAST:.3g}% contrast, on elements of {size_mm:.3g} mm"
    )
    criterion = "discrepancy" if given is None else "given"
    return ParameterChoice(value, how, figure, "α", criterion=criterion), variance


def _alpha_of_discrepancy(problem: ImagingProblem, evidence: Evidence) -> float:
    if evidence.variance is None:
        raise NumericsError(
            "the discrepancy principle needs the noise, and no reading is repeated to estimate it from",
            remedy="give the hyperparameter itself",
        )
    changes = evidence.changes[:_FRAMES]
    largest = float(np.abs(changes).max())
    if largest < _NOTHING * np.abs(problem.reference).max():
        raise NumericsError(
            f"the changes to choose α on are at most {largest:.2g}: the same as their reference",
            remedy="choose it on readings of a load, or give the hyperparameter itself",
        )
    if evidence.variance <= (np.finfo(float).eps * largest) ** 2:
        raise NumericsError(
            "the changes to choose α on have no noise: repeated readings are identical to the last digit",
            remedy="choose it on readings as measured, or give the hyperparameter itself",
        )
    white = WhiteReadings.from_problem(problem)
    search = _Search(TotalVariation(problem.mesh, white.rows), white.white(changes), evidence.variance)
    return float(f"{search.alpha():.6g}")


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """Residual against α, for white readings (n, g) of a variance."""

    method: TotalVariation
    readings: Array
    variance: float

    def alpha(self) -> float:
        """Return α at which the mean squared residual is the variance."""
        upper = max(self.method.flattening(frame) for frame in self.readings)
        if self.excess(upper) < _CLEAR * np.sqrt(2 / self.readings.size):
            raise NumericsError(
                "the changes to choose α on are only noise: a flat image explains them",
                remedy="give the hyperparameter itself, or choose it on a clearer change",
            )
        lower, least = upper / _STEP, _LEAST * upper
        while self.excess(lower) > 0:
            upper, lower = lower, lower / _STEP
            if lower < least:
                raise NumericsError(
                    "no image explains the changes to choose α on to within the noise",
                    remedy="give the hyperparameter itself, or check geometry and noise",
                )
        root = brentq(lambda log: self.excess(float(np.exp(log))), np.log(lower), np.log(upper), xtol=_EXACT)
        return float(np.exp(root))

    def excess(self, alpha: float) -> float:
        """Logarithm of the mean squared residual over the variance."""
        residuals = [self.method.image(frame, alpha).residual for frame in self.readings]
        return float(np.log(max(sum(residuals), np.finfo(float).tiny) / self.readings.size / self.variance))


def _noise_figure(problem: ImagingProblem, alpha: float, evidence: Evidence) -> tuple[float, float]:
    """Noise figure (Adler et al. 2009 form) at the evidence's contrast and noise, and its jackknife error."""
    assert evidence.variance is not None
    white = WhiteReadings.from_problem(problem)
    method = TotalVariation(problem.mesh, white.rows)
    images = np.array([method.image(draw, alpha).image for draw in white.white(evidence.changes)])
    images *= problem.mesh.areas_mm2
    relative = np.ones(1) if problem.noise_variance is None else problem.noise_variance
    snr = float(np.abs(central_signal(problem, CONTRAST)).mean() / np.sqrt(evidence.variance * relative.mean()))
    left_out = [snr / _image_snr(np.delete(images, draw, axis=0)) for draw in range(len(images))]
    spread = np.sqrt((len(images) - 1) * np.var(left_out))
    return snr / _image_snr(images), float(spread)


def _image_snr(images: Array) -> float:
    """Mean size of the mean image over the root of the mean variance."""
    noise = np.sqrt(images.var(axis=0, ddof=1).mean())
    return float(np.abs(images.mean(axis=0)).mean() / noise) if noise > 0 else np.inf
