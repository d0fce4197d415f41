"""An estimate against a reference that is not known exactly: scatter is estimated, the reference's share is known.

    half width = √((t(ν) s)² + (z u)²)

s is the standard error of the readings, on ν degrees of freedom, and u what the reference's own standard uncertainty
adds. Effective degrees of freedom (Welch and Satterthwaite, GUM G.4) would multiply √(s² + u²) by one t of more
degrees of freedom. Of three readings that shrinks t by more than u adds, so that a stated uncertainty narrowed
intervals, and they held the truth too seldom (92.5 % instead of 95 %). Here each part has its own factor: what is
known adds, always. By simulation such intervals hold the truth at least as often as they say, and more often of few
readings with an uncertainty as large as their scatter (95 % ones of three in up to 97.5 %).
"""

from dataclasses import dataclass
from math import exp, hypot, log

from scipy import stats
from scipy.optimize import brentq

from cbsr_qa.stats.samples import Interval, share

#: Tails below it are zero: quantiles of smaller ones are no numbers.
_LEAST_TAIL = 1e-300


@dataclass(frozen=True, slots=True)
class Referenced:
    """An estimate with an error that was estimated, and one that is known.

    Parameters
    ----------
    value : in the unit of all that follows.
    scatter : standard error of the readings, above 0.
    freedom : its degrees of freedom, above 0.
    known : what references' standard uncertainties add, at least 0; 0 gives Student's t interval.
    """

    value: float
    scatter: float
    freedom: float
    known: float = 0.0

    @property
    def standard_error(self) -> float:
        """Return the standard error of both together."""
        return hypot(self.scatter, self.known)

    def statistic(self, null: float = 0.0) -> float:
        """Return how many standard errors the estimate is above ``null``."""
        return (self.value - null) / self.standard_error

    def interval(self, confidence: float = 0.95) -> Interval:
        """Return value ± half width; never narrower than without what is known.

        Raises
        ------
        NumericsError
            The confidence is not between 0 and 1.
        """
        share(confidence, "confidence")
        half = self._half((1 - confidence) / 2)
        return Interval(self.value - half, self.value + half, confidence)

    def p_value(self, null: float = 0.0) -> float:
        """Return the two-sided p value of ``null``: 1 − the confidence of the interval that just reaches it."""
        away = abs(self.value - null)
        # t is wider than z: the p value lies between those of t with the scatter alone and with both errors.
        low = float(stats.t.sf(away / self.scatter, self.freedom))
        high = float(stats.t.sf(away / self.standard_error, self.freedom))
        if self.known == 0 or high - low <= 1e-12 * high:
            return 2 * high
        low = max(low / 2, _LEAST_TAIL)
        if high <= low or self._half(low) <= away:
            return 0.0
        tail = brentq(lambda logarithm: self._half(exp(logarithm)) - away, log(low), log(min(2 * high, 0.5)))
        return 2 * exp(tail)

    def _half(self, tail: float) -> float:
        """Half width that leaves this much on each side."""
        estimated = float(stats.t.isf(tail, self.freedom)) * self.scatter
        return hypot(estimated, float(stats.norm.isf(tail)) * self.known)
