"""Sample sizes: to detect a difference, and to show equivalence within a margin.

Power of the two-sided two-sample t test (Cohen 1988, chapter 2):

    power = P(|T| > t_(1−α/2, ν)),  T noncentral t with ν = n₁ + n₂ − 2 and δ = (Δ/σ) √(n₁n₂/(n₁ + n₂))

Power of two one-sided tests where the groups do not differ, with X = √(χ²_ν/ν) (Schuirmann 1987; Phillips 1990):

    power = P(|Z| < δ − t_(1−α, ν) X) = ∫ (2 Φ(δ − t x) − 1) f_X(x) dx over x < δ/t,  δ = (m/σ) √(n₁n₂/(n₁ + n₂))
"""

from collections.abc import Callable
from math import sqrt
from typing import Final

import numpy as np
from scipy import special, stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.samples import share, smallest

_MOST = 10**9  #: sensors per group; more is not a practical plan
_SURE = 40.0  #: δ beyond which a test of this level cannot miss, so that the noncentral t need not be summed
_ONE_SIDED: Final = 10.0  #: δ beyond which the wrong side has negligible probability; scipy's tail there may be NaN
_TAIL: Final = 1e-14  #: of the estimated deviation's distribution, left out at either end
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(128)


def power(size: float, first: int, second: int, *, level: float = 0.05) -> float:
    """Return the probability of detecting a difference of ``size`` deviations, Δ/σ, by the two-sided test.

    Raises
    ------
    NumericsError
        Fewer than three sensors in all, or a level that is not between 0 and 1.
    """
    freedom, shift = _test(size, first, second, level)
    critical = float(stats.t.isf(level / 2, freedom))
    if shift > critical + _SURE and freedom > 30:
        return 1.0
    missed = special.nctdtr(freedom, shift, critical)
    if shift < _ONE_SIDED:
        missed -= special.nctdtr(freedom, shift, -critical)
    return float(min(max(1 - missed, 0.0), 1.0))


def power_of_equivalence(margin: float, first: int, second: int, *, level: float = 0.05) -> float:
    """Return the probability of showing equivalence within ± ``margin`` deviations for two equal groups.

    Raises as :func:`power` does.
    """
    freedom, shift = _test(max(margin, 0.0), first, second, level)
    critical = float(stats.t.isf(level, freedom))
    low, high = (sqrt(end / freedom) for end in (stats.chi2.ppf(_TAIL, freedom), stats.chi2.isf(_TAIL, freedom)))
    high = min(high, shift / critical)
    if high <= low:
        return 0.0
    s = low + (high - low) * (1 + _NODES) / 2
    density = 2 * freedom * s * stats.chi2.pdf(freedom * s**2, freedom)
    chance_shown = 2 * special.ndtr(shift - critical * s) - 1
    return float(np.clip((high - low) / 2 * np.sum(_WEIGHTS * density * chance_shown), 0.0, 1.0))


def sensors_needed(size: float, *, wanted: float = 0.8, level: float = 0.05) -> int:
    """Return the size of each of two equal groups needed to detect a difference of ``size`` deviations, Δ/σ.

    Raises
    ------
    NumericsError
        The difference is zero, more than 10⁹ sensors would be needed, or a share is not between 0 and 1.
    """
    _check_wanted(wanted, level)
    if not abs(size) > 0:
        raise NumericsError(f"power: no number of sensors detects a difference of {size:g} deviations")
    return _fewest(lambda count: power(size, count, count, level=level) >= wanted, size)


def sensors_to_show_alike(margin: float, *, wanted: float = 0.8, level: float = 0.05) -> int:
    """Return the size of each of two equal groups needed to show equivalence within ± margin deviations.

    Raises
    ------
    NumericsError
        The margin is not positive, more than 10⁹ sensors would be needed, or a share is not between 0 and 1.
    """
    _check_wanted(wanted, level)
    if not margin > 0:
        raise NumericsError(f"power: no number of sensors shows two groups alike within {margin:g} deviations")
    return _fewest(lambda count: power_of_equivalence(margin, count, count, level=level) >= wanted, margin)


def _test(size: float, first: int, second: int, level: float) -> tuple[int, float]:
    """Return degrees of freedom, and δ: the size in standard errors of the groups' difference."""
    share(level, "level")
    if min(first, second) < 1 or first + second < 3:
        raise NumericsError(f"power: groups of {first} and {second} sensors are too small for a t test")
    return first + second - 2, abs(size) * sqrt(first * second / (first + second))


def _check_wanted(wanted: float, level: float) -> None:
    share(wanted, "power"), share(level, "level")
    if wanted <= level:
        raise NumericsError(f"power: {wanted:g} is not above the level {level:g}, which chance alone reaches")


def _fewest(enough: Callable[[int], bool], size: float) -> int:
    return smallest(enough, 1, _MOST, f"power: {size:g} deviations need more than {_MOST:g} sensors a group")
