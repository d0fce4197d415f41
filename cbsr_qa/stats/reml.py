"""Ratio of variances θ = σ²_sensor/σ² by restricted maximum likelihood, with everything else profiled out.

With A = XᵀH⁻¹X, R = rᵀH⁻¹r (r the generalised least-squares residuals) and f = N − p, minus twice the log likelihood
is

    ℓ(θ) = Σ log(1 + n θ) + log|A| + f (1 + log(2πR/f))             restricted (as lme4's REML criterion)
    ℓ(θ) = Σ log(1 + n θ)          + N (1 + log(2πR/N))             full

Its derivative is found in closed form, so that θ is a root and has all its digits. The interval holds the θ ≥ 0 for
which ℓ exceeds its minimum by no more than χ² of one degree of freedom. Sources: Patterson & Thompson 1971;
Bates et al. 2015 (the profiled criterion); Pinheiro & Bates 2000, section 2.4 (profile intervals).
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import log, pi

import numpy as np
from scipy import optimize, stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.samples import Interval
from cbsr_qa.stats.sensor_sums import SensorSums

#: θ that are tried before the minimum is refined; the likelihood may have two.
_GRID = np.concatenate([[0.0], np.logspace(-7, 12, 77)])
_FARTHEST = 1e14
_MOST_ELEMENTS = 2_000_000


@dataclass(frozen=True, slots=True)
class Ratio:
    """θ, its profile interval, the criterion there, and σ² of the sums' response."""

    value: float
    interval: Interval
    criterion: float
    variance: float


@dataclass(frozen=True, slots=True, eq=False)
class Likelihood:
    """Profile criterion of θ; see the module."""

    sums: SensorSums
    restricted: bool = True

    @property
    def freedom(self) -> int:
        """Return f: N − p, or N for the full likelihood."""
        return self.sums.runs - (self.sums.columns if self.restricted else 0)

    def criterion(self, ratio: Array) -> Array:
        """Return ℓ of θ, (k,) → (k,)."""
        logs = np.concatenate([self._logs(some) for some in np.array_split(ratio, self._blocks(len(ratio)))])
        spread = np.log1p(np.multiply.outer(ratio, self.sums.sizes)) @ self.sums.sensors
        determinant = 2 * logs[:, :-1].sum(axis=1) if self.restricted else 0.0
        f = self.freedom
        value: Array = spread + determinant + f * (1 + log(2 * pi / f) + 2 * logs[:, -1])
        return value

    def _logs(self, ratio: Array) -> Array:
        """Logarithms of the Cholesky factor's diagonal: of A, and √R last."""
        factor = np.linalg.cholesky(self.sums.within + self.sums.products(ratio))
        logs: Array = np.log(np.diagonal(factor, axis1=-2, axis2=-1))
        return logs

    def _blocks(self, count: int) -> int:
        """In how many parts so many θ are tried: hundreds of groups would fill the memory at once."""
        return max(1, min(count, count * self.sums.within.size // _MOST_ELEMENTS))

    def slope(self, ratio: float) -> float:
        """Return dℓ/dθ = Σ n h − tr(A⁻¹ XᵀH⁻¹ZZᵀH⁻¹X) − f rᵀH⁻¹ZZᵀH⁻¹r / R."""
        whole = self.sums.within + self.sums.products(ratio)
        moved = self.sums.products(ratio, 2, 1)
        effects = np.linalg.solve(whole[:-1, :-1], whole[:-1, -1])
        turned = np.append(-effects, 1.0)
        lost = np.linalg.solve(whole[:-1, :-1], moved[:-1, :-1])
        trace = float(np.trace(lost)) if self.restricted else 0.0
        squares = float(turned @ whole @ turned)
        return self.sums.trace(ratio, 1, 1) - trace - self.freedom * float(turned @ moved @ turned) / squares

    def variance(self, ratio: float) -> float:
        """Return σ² = R/f."""
        whole = self.sums.within + self.sums.products(ratio)
        return float(np.linalg.cholesky(whole)[-1, -1]) ** 2 / self.freedom


def variance_ratio(sums: SensorSums, *, restricted: bool = True, confidence: float = 0.95) -> Ratio:
    """Return θ of least criterion, 0 where the likelihood falls from there on.

    Raises
    ------
    NumericsError
        Runs of one sensor differ so little that the ratio has no bound.
    """
    likelihood = Likelihood(sums, restricted)
    values = likelihood.criterion(_GRID)
    best = int(np.argmin(values))
    if best == len(_GRID) - 1:
        raise NumericsError("sensor variance: runs of one sensor hardly differ, and its ratio to theirs has no bound")
    low, high = float(_GRID[max(best - 1, 0)]), float(_GRID[best + 1])
    value = _root(likelihood.slope, low, high)
    least = float(likelihood.criterion(np.array([value]))[0])
    interval = _interval(likelihood, value, least, confidence)
    return Ratio(value, interval, least, likelihood.variance(value))


def _root(slope: Callable[[float], float], low: float, high: float) -> float:
    if slope(low) >= 0:  # at low = 0: the likelihood falls from there on
        return low
    if slope(high) <= 0:
        return high
    return float(optimize.brentq(slope, low, high, xtol=1e-15, rtol=1e-14))


def _interval(likelihood: Likelihood, value: float, least: float, confidence: float) -> Interval:
    allowed = least + float(stats.chi2.ppf(confidence, 1))

    def excess(ratio: float) -> float:
        return float(likelihood.criterion(np.array([ratio]))[0]) - allowed

    low = 0.0 if value == 0.0 or excess(0.0) <= 0 else float(optimize.brentq(excess, 0.0, value, rtol=1e-10))
    high = max(2 * value, 0.1)
    while excess(high) < 0:
        high *= 4
        if high > _FARTHEST:
            raise NumericsError("sensor variance: the likelihood puts no upper bound on it")
    return Interval(low, float(optimize.brentq(excess, value, high, rtol=1e-10)), confidence)
