"""Noncentrality of Student's t from an observed value: what exact intervals of standardised quantities invert."""

from math import isnan, sqrt

from scipy import optimize, stats

#: Beyond it the normal part of a noncentral t is nothing beside its χ part (1e-8), and its series no longer converge.
_LARGE = 1e4


def noncentrality(t: float, freedom: float, below: float) -> float:
    """Return δ for which a noncentral t of these degrees of freedom lies below ``t`` with this probability.

    Parameters
    ----------
    t : observed statistic.
    freedom : ν > 0.
    below : share between 0 and 1; the larger, the smaller δ.

    Notes
    -----
    T = (Z + δ)/√(χ²_ν/ν). For |t| > 10⁴, Z is left out: δ = t √(χ²/ν) at the quantile of χ² that is exceeded with
    this probability.
    """
    if t < 0:
        return -noncentrality(-t, freedom, 1 - below)  # the mirrored tail keeps its digits
    if t > _LARGE:
        return t * sqrt(float(stats.chi2.isf(below, freedom)) / freedom)

    def excess(delta: float) -> float:
        share = float(stats.nct.cdf(t, freedom, delta))
        # Where δ lies far below 0 and t far above it scipy's series gives no number for what is 1 to every digit.
        return (1.0 if isnan(share) and delta < 0 else share) - below

    step = 5 + t
    low, high = t - step, t + step
    while excess(low) < 0:
        low -= step
    while excess(high) > 0:
        high += step
    return float(optimize.brentq(excess, low, high, xtol=1e-10, rtol=1e-12))
