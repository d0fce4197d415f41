"""How many sensors a difference needs: power of the two-sided two-sample t test, exact by the noncentral t.

    power = P(|T| > t_(1−α/2, ν)),  T noncentral t with ν = n₁ + n₂ − 2 and δ = (Δ/σ) √(n₁n₂/(n₁ + n₂))

Source: Cohen 1988, chapter 2; the noncentral t instead of his tables' approximation.
"""

from math import sqrt

from scipy import special, stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.samples import share

_MOST = 10**9  #: sensors a group; more is no plan
_SURE = 40.0  #: δ beyond which a test of this level cannot miss, and the noncentral t need not be summed


def power(size: float, first: int, second: int, *, level: float = 0.05) -> float:
    """Return the probability of finding a difference.

    Parameters
    ----------
    size : Δ/σ, the true difference in deviations.
    first, second : sensors a group, at least three in all.
    level : of the two-sided test.

    Raises
    ------
    NumericsError
        Groups that have no test, or a level that is none.
    """
    share(level, "level")
    if min(first, second) < 1 or first + second < 3:
        raise NumericsError(f"power: groups of {first} and {second} sensors have no t test")
    freedom = first + second - 2
    shift = abs(size) * sqrt(first * second / (first + second))
    critical = float(stats.t.isf(level / 2, freedom))
    if shift > critical + _SURE and freedom > 30:
        return 1.0
    missed = special.nctdtr(freedom, shift, critical) - special.nctdtr(freedom, shift, -critical)
    return float(min(max(1 - missed, 0.0), 1.0))


def sensors_needed(size: float, *, wanted: float = 0.8, level: float = 0.05) -> int:
    """Return how many sensors each of two equal groups needs to find a difference.

    Parameters
    ----------
    size : Δ/σ of the difference that must not be missed; its sign does not matter.
    wanted : power, above the level.
    level : of the two-sided test.

    Raises
    ------
    NumericsError
        No difference is asked for, more than 10⁹ sensors would be needed, or a share is none.
    """
    share(wanted, "power"), share(level, "level")
    if wanted <= level:
        raise NumericsError(f"power: {wanted:g} is not above the level {level:g}, which a guess already has")
    if not abs(size) > 0:
        raise NumericsError(f"power: no number of sensors finds a difference of {size:g} deviations")
    fewer, count = 1, 2
    while power(size, count, count, level=level) < wanted:
        fewer, count = count, 2 * count
        if count > _MOST:
            raise NumericsError(f"power: {size:g} deviations need more than {_MOST:g} sensors a group")
    while count - fewer > 1:
        middle = (count + fewer) // 2
        enough = power(size, middle, middle, level=level) >= wanted
        fewer, count = (fewer, middle) if enough else (middle, count)
    return count
