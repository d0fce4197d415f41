"""Noise variance of each reading, shrunk towards a common value, and folding of reciprocal readings.

Variances are *moderated* (Smyth 2004, eqs 6, 8 and 10): readings' true variances are assumed to scatter about a
common one by a scaled inverse χ² law of ν₀ degrees of freedom, ν₀ and the common s₀² are found from the scatter of
the logarithms over all readings, and

    s̃² = (ν₀ s₀² + ν s²) / (ν₀ + ν),    ν = n − 2,

of which 1/s̃² is the posterior mean of a reading's weight. ν₀ is not made robust against few loud readings (as by
Phipson et al. 2016): that would shrink those that should have less weight.

Reciprocal readings are equal (Geselowitz 1971): their weighted mean Σ(y/v)/Σ(1/v), of variance 1/Σ(1/v), is a
sufficient statistic. Their difference gives the size of their noise.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.special import digamma, polygamma

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.sensor.patterns import DrivePattern

_SAME = 1e-6  # reference readings that are folded must agree within this, relative to the largest


@dataclass(frozen=True, slots=True, eq=False)
class ReadingFold:
    """Equal readings among m, as g groups.

    Parameters
    ----------
    group : (m,) int64, 0 to g − 1, in the order of first readings.
    first : (g,) int64, first reading of each group.
    sign : (m,) float64, +1 or −1 relative to the first reading of the group.
    weight : (m,) float64, sign times share in the mean; magnitudes sum to one in each group.
    variance : (g,) float64 variance of the means, relative as the problem's.
    """

    group: Indices
    first: Indices
    sign: Array
    weight: Array
    variance: Array

    @classmethod
    def from_problem(cls, problem: ImagingProblem) -> Self:
        """Fold a problem's readings; no folding if its own reference contradicts reciprocity."""
        group, first_readings, sign = _groups(problem.sensor_type.pattern, problem.used)
        reference = problem.reference
        asymmetry = np.abs(reference - sign * reference[first_readings][group])
        if asymmetry.max(initial=0.0) > _SAME * np.abs(reference).max():
            group = first_readings = np.arange(len(reference))
            sign = np.ones(len(reference))
        variance = np.ones(len(reference)) if problem.noise_variance is None else problem.noise_variance
        information = np.bincount(group, 1 / variance)
        return cls(group, first_readings, sign, sign / variance / information[group], 1 / information)

    def rows(self, jacobian: Array) -> Array:
        """Jacobian (g, e) of the folded readings."""
        return jacobian[self.first]

    def fold(self, readings: Array) -> Array:
        """Weighted means (n, g) of readings (n, m)."""
        folded = np.zeros((len(readings), len(self.first)))
        np.add.at(folded.T, self.group, (readings * self.weight).T)
        return folded

    def unfold(self, matrix: Array) -> Array:
        """Matrix (k, m) for all readings, from one (k, g) for their means."""
        unfolded: Array = matrix[:, self.group]
        unfolded *= self.weight
        return unfolded

    def noise(self, readings: Array) -> tuple[float, int]:
        """Mean variance of readings (n, m) for unit relative variance, from the differences of reciprocal ones.

        Returns
        -------
        The estimate and its degrees of freedom, 0 where no readings are folded.
        """
        freedom = len(readings) * (len(self.group) - len(self.first))
        if not freedom:
            return 0.0, 0
        size = np.bincount(self.group)
        informed = np.abs(self.weight) / self.variance[self.group]  # 1/v of every reading
        residuals = readings - self.fold(readings)[:, self.group] * self.sign
        is_repeated = size[self.group] > 1
        return float((residuals[:, is_repeated] ** 2 @ informed[is_repeated]).sum() / freedom), freedom


def _groups(pattern: DrivePattern, used: Mask) -> tuple[Indices, Indices, Array]:
    """Group, first reading of each group, and relative sign of every used reading."""
    names, signs = (table[used] for table in pattern.reading_groups())
    _, first_places, group = np.unique(names, return_index=True, return_inverse=True)
    order = np.argsort(first_places)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    first_readings, group = first_places[order], rank[group]
    relative: Array = np.asarray(signs * signs[first_readings][group], dtype=np.float64)
    return group.astype(np.int64), first_readings.astype(np.int64), relative


#: Smallest number of frames; fewer leave too few degrees of freedom to distinguish noisy readings from chance.
FEWEST_FRAMES: Final = 6

_REMEDY: Final = 'or set analysis.noise_weighting = "equal" in the recipe'
_MAX_SILENT_SHARE: Final = 0.5  # share of readings that never change, above which the noise is unknown
_ROUNDING: Final = 1e-13  # of the largest level: less is equal
_CLIP: Final = 3.0  # deviations are limited to this many times the spread, so that a glitch does not count as noise
_CLIPPED_VARIANCE: Final = 0.99501  # E min(z², 9) of a standard normal z
_DEVIATION: Final = 1.4826  # standard deviation of normal noise over its median absolute deviation
_ROUNDS: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class ReadingNoise:
    """Noise of each reading.

    Parameters
    ----------
    variance : (m,) float64, moderated, in the square of the readings' unit.
    common : s₀², towards which they were shrunk.
    common_freedom : ν₀, in frames' worth of evidence; infinite if the readings do not differ beyond chance.
    silent : (m,) bool, readings that never changed; their noise is unknown and taken as the common one.
    """

    variance: Array
    common: float
    common_freedom: float
    silent: Mask


def reading_noise(readings: Array, time_s: Array) -> ReadingNoise:
    """Estimate the noise of readings from frames with drift but no other changes.

    Deviations are from a straight line in time, limited to three times their spread (Huber's winsorised fit).
    Variances are at least that of rounding to the converter's step, step²/12.

    Parameters
    ----------
    readings : (n, m) float64, in any unit.
    time_s : (n,) float64, rising.

    Raises
    ------
    NumericsError
        If there are fewer than six frames, a reading is not finite, or more than half of the readings never change.
    """
    count = len(readings)
    if count < FEWEST_FRAMES:
        raise NumericsError(
            f"{count} unloaded frames are too few to weight readings by their noise; {FEWEST_FRAMES} are needed",
            remedy=f"take more unloaded frames, {_REMEDY}",
        )
    bad = ~np.isfinite(readings)
    if bad.any():
        raise NumericsError(
            f"{int(bad.any(axis=0).sum())} readings are non-finite in the unloaded frames",
            remedy=f"make the driver flag such readings as missing, {_REMEDY}",
        )
    rounding = _ROUNDING * float(np.abs(readings).max())
    silent = np.ptp(readings, axis=0) <= rounding
    if silent.mean() > _MAX_SILENT_SHARE:
        raise NumericsError(
            f"{int(silent.sum())} of {len(silent)} readings are the same in all {count} unloaded frames: there is no"
            " noise to weight readings by",
            remedy=f"measure with a finer resolution, {_REMEDY}",
        )
    # Median over readings of the smallest difference between two values of one; almost zero without rounding.
    differences = np.diff(np.sort(readings[:, ~silent], axis=0), axis=0)
    step = float(np.median(np.where(differences > rounding, differences, np.inf).min(axis=0)))
    raw_variance = np.maximum(_estimate_scatter(readings[:, ~silent], time_s, step), step**2 / 12)
    moderated, common_variance, freedom = _moderate_variances(raw_variance, count - 2)
    variance = np.full(len(silent), common_variance)
    variance[~silent] = moderated
    return ReadingNoise(variance, common_variance, freedom, silent)


def _estimate_scatter(readings: Array, time_s: Array, step: float) -> Array:
    """Winsorised variance about a straight line in time, (m,)."""
    count = len(readings)
    q, _ = np.linalg.qr(np.column_stack([np.ones(count), time_s - time_s.mean()]))
    least, freedom = step / np.sqrt(12), count - 2
    values = readings - np.median(readings, axis=0)
    clipped = values
    for _ in range(_ROUNDS):
        line = q @ (q.T @ clipped)
        residuals = values - line
        spread = np.maximum(_DEVIATION * np.sqrt(count / freedom) * np.median(np.abs(residuals), axis=0), least)
        clipped = line + np.clip(residuals, -_CLIP * spread, _CLIP * spread)
    residuals = clipped - q @ (q.T @ clipped)
    variance: Array = (residuals**2).sum(axis=0) / (freedom * _CLIPPED_VARIANCE)
    return variance


def _moderate_variances(own: Array, freedom: int) -> tuple[Array, float, float]:
    """Return s̃², s₀² and ν₀ of variances with this many degrees of freedom each; Smyth 2004, section 6.2."""
    level = np.log(own) - digamma(freedom / 2) + np.log(freedom / 2)
    beyond_chance = float(level.var(ddof=1) - polygamma(1, freedom / 2)) if len(own) > 1 else 0.0
    mean = float(level.mean())
    if beyond_chance <= 0:
        common_variance = float(np.exp(mean))
        return np.full_like(own, common_variance), common_variance, float("inf")
    prior = 2 * _inverse_trigamma(beyond_chance)
    common_variance = float(np.exp(mean + digamma(prior / 2) - np.log(prior / 2)))
    moderated: Array = (prior * common_variance + freedom * own) / (prior + freedom)
    return moderated, common_variance, prior


def _inverse_trigamma(value: float) -> float:
    """Return y with ψ′(y) = value, by the Newton iteration of Smyth 2004, appendix; it converges from below."""
    y = 0.5 + 1 / value
    for _ in range(50):
        slope = float(polygamma(1, y))
        step = slope * (1 - slope / value) / float(polygamma(2, y))
        y += step
        if -step < 1e-10 * y:
            break
    return y
