"""Noncentrality of Student's t from an observed value: what exact intervals of standardised quantities invert."""

from functools import lru_cache
from math import isnan, sqrt
from typing import Final

import numpy as np
from scipy import optimize, special, stats

from cbsr_qa.domain.numbers import Array

#: Beyond it the normal part of a noncentral t is nothing beside its χ part (1e-8), and its series no longer converge.
_LARGE = 1e4
_TAIL: Final = 1e-16  #: share of χ² beyond each end of the integral
_NODES: Final = 400


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
        share = float(special.nctdtr(freedom, delta, t))
        return (integrated(t, freedom, delta) if isnan(share) else share) - below

    step = 5 + t
    low, high = t - step, t + step
    while excess(low) < 0:
        low -= step
    while excess(high) > 0:
        high += step
    return float(optimize.brentq(excess, low, high, xtol=1e-10, rtol=1e-12))


def integrated(t: float, freedom: float, delta: float) -> float:
    """Return P(T ≤ t) by integrating Φ(t s − δ) over s = √(χ²/ν).

    It is slower than scipy's series, which gives no number for some large ν and |δ|.
    """
    ends = np.sqrt(np.array([stats.chi2.ppf(_TAIL, freedom), stats.chi2.isf(_TAIL, freedom)]) / freedom)
    nodes, weights = _legendre()
    half = 0.5 * (ends[1] - ends[0])
    s = ends[0] + half * (1 + nodes)
    density = 2 * freedom * s * stats.chi2.pdf(freedom * s**2, freedom)
    return float(np.sum(half * weights * density * special.ndtr(t * s - delta)))


@lru_cache(maxsize=1)
def _legendre() -> tuple[Array, Array]:
    """Nodes and weights of Gauss and Legendre between −1 and 1, found once."""
    nodes, weights = special.roots_legendre(_NODES)
    return nodes, weights
