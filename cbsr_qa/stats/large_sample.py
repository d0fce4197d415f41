"""Intervals of sums and differences of mean squares: modified large-sample, and of their ratios by pivots.

For γ = Σ c_q θ_q with independent S_q² ~ θ_q χ²_n/n the limits are γ̂ − √V_L and γ̂ + √V_U, where V_L and V_U are such
that the interval is exact whenever all but one θ vanish (Graybill & Wang 1980 for sums; Ting, Burdick, Graybill,
Jeyaratnam & Lu 1990 with differences; Burdick & Graybill 1992, section 3.3). Ratios, for which there is no such form
in general, take the generalised pivotal quantities n S²/χ²_n (Hamada & Weerahandi 2000).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy import stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.samples import Interval

_DRAWS = 20_000


@dataclass(frozen=True, slots=True)
class MeanSquare:
    """S² with n degrees of freedom, counted ``factor`` times; negative ones are subtracted."""

    value: float
    freedom: int
    factor: float = 1.0

    @property
    def term(self) -> float:
        """Return |c| S²."""
        return abs(self.factor) * self.value


@dataclass(frozen=True, slots=True)
class _Tails:
    """Coefficients G, H and their mixed kinds at one tail probability."""

    tail: float

    def g(self, n: int) -> float:
        return 1 - n / float(stats.chi2.isf(self.tail, n))

    def h(self, n: int) -> float:
        return n / float(stats.chi2.ppf(self.tail, n)) - 1

    def g_mixed(self, plus: int, minus: int) -> float:
        f = float(stats.f.isf(self.tail, plus, minus))
        return ((f - 1) ** 2 - self.g(plus) ** 2 * f**2 - self.h(minus) ** 2) / f

    def h_mixed(self, plus: int, minus: int) -> float:
        f = float(stats.f.ppf(self.tail, plus, minus))
        return ((1 - f) ** 2 - self.h(plus) ** 2 * f**2 - self.g(minus) ** 2) / f

    def alike(self, one: int, two: int) -> float:
        whole = self.g(one + two) ** 2 * (one + two) ** 2 / (one * two)
        return whole - self.g(one) ** 2 * one / two - self.g(two) ** 2 * two / one


def sum_interval(parts: Sequence[MeanSquare], confidence: float) -> Interval:
    """Return the interval of Σ c_q θ_q, where at least one factor is positive."""
    tails = _Tails((1 - confidence) / 2)
    plus = [part for part in parts if part.factor > 0]
    minus = [part for part in parts if part.factor < 0]
    value = sum(part.factor * part.value for part in parts)
    below = sum((tails.g(p.freedom) * p.term) ** 2 for p in plus)
    below += sum((tails.h(m.freedom) * m.term) ** 2 for m in minus)
    above = sum((tails.h(p.freedom) * p.term) ** 2 for p in plus)
    above += sum((tails.g(m.freedom) * m.term) ** 2 for m in minus)
    below += sum(tails.g_mixed(p.freedom, m.freedom) * p.term * m.term for p in plus for m in minus)
    above += sum(tails.h_mixed(p.freedom, m.freedom) * p.term * m.term for p in plus for m in minus)
    if plus and minus:
        below += _pairs(plus, tails)
        above += _pairs(minus, tails)
    return Interval(value - sqrt(max(below, 0.0)), value + sqrt(max(above, 0.0)), confidence)


def _pairs(parts: Sequence[MeanSquare], tails: _Tails) -> float:
    """Cross terms of mean squares of one sign."""
    total = 0.0
    for index, one in enumerate(parts):
        for two in parts[index + 1 :]:
            total += tails.alike(one.freedom, two.freedom) * one.term * two.term
    return total / (len(parts) - 1) if len(parts) > 1 else 0.0


def pivot_interval(squares: Sequence[MeanSquare], function: Callable[[Array], Array], confidence: float) -> Interval:
    """Return the interval of a function of the true mean squares.

    Parameters
    ----------
    squares : of k sources.
    function : (k, draws) ndarray of mean squares → (draws,).
    confidence : share between 0 and 1; draws come from a fixed seed, so that one study has one interval.
    """
    random = np.random.default_rng(20000415)
    drawn = np.array([one.freedom * one.value / random.chisquare(one.freedom, _DRAWS) for one in squares])
    tail = (1 - confidence) / 2
    low, high = np.quantile(function(drawn), [tail, 1 - tail])
    return Interval(float(low), float(high), confidence)
