"""Guard bands inside a limit and the remaining risks (JCGM 106:2012, clauses 8.3 and 9).

The true value η of a sensor has a density g (the lot's), the measured one is normal about it with standard deviation
u. Behind an upper limit T with acceptance limit A = T − w,

    consumer's risk = ∫_{η > T} P(measured ≤ A | η) g(η) dη     a bad sensor is accepted
    producer's risk = ∫_{η ≤ T} P(measured > A | η) g(η) dη     a good sensor is rejected
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, log, log1p, sqrt

import numpy as np
from scipy import special, stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.averaged_bound import HEAVIEST, LOG_NORMAL, NORMAL, FamilyShare, family_of
from cbsr_qa.stats.families import LargestNormal
from cbsr_qa.stats.golden_lots import Bound, Runs, Scale
from cbsr_qa.stats.lot_shapes import Distribution
from cbsr_qa.stats.variance_components import FEWEST_REPEATS, components

#: Density of true values: (n,) values → (n,) densities.
Density = Callable[[Array], Array]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(400)
_REACH = 8.0  #: standard uncertainties beyond which a measurement does not mislead


@dataclass(frozen=True, slots=True)
class Risks:
    """Shares of all sensors, between 0 and 1."""

    consumer: float
    producer: float

    def __add__(self, other: "Risks") -> "Risks":
        """Add the risks of the other bound; conservative, since a sensor at risk from both counts twice."""
        return Risks(self.consumer + other.consumer, self.producer + other.producer)


def risks_of_bound(density: Density, limit: float, guard: float, uncertainty: float) -> Risks:
    """Return the risks of an upper limit T with a guard band w ≥ 0 inside it and standard uncertainty u > 0.

    For a lower limit give the mirrored density and limit.
    """
    accepted_to = limit - guard

    def acceptance_probability(true: Array) -> Array:
        return special.ndtr((accepted_to - true) / uncertainty)

    bad, bad_weights = _panel(limit, limit + _REACH * uncertainty)
    good, good_weights = _panel(accepted_to - _REACH * uncertainty, limit)
    consumer = float(np.sum(bad_weights * acceptance_probability(bad) * density(bad)))
    producer = float(np.sum(good_weights * (1 - acceptance_probability(good)) * density(good)))
    return Risks(consumer, producer)


def _panel(low: float, high: float) -> tuple[Array, Array]:
    half_width = 0.5 * (high - low)
    return low + half_width * (_NODES + 1), half_width * _WEIGHTS


#: An expanded uncertainty has the coverage of ± 2 standard deviations of a normal distribution.
EXPANDED_SHARE = 0.9545
#: Spread of true values, in standard uncertainties, below which the lot cannot determine their density.
_LEAST_SPREAD = 0.1


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Measurement uncertainty of one run.

    Parameters
    ----------
    standard : u, one standard deviation in the measurement's unit; above 0.
    freedom : degrees of freedom; None if it was stated rather than found from repeats.
    source : source of the uncertainty, in words.
    """

    standard: float
    freedom: int | None
    source: str

    @property
    def coverage_factor(self) -> float:
        """K of the expanded uncertainty U = K u: 2, or Student's t if u comes from few repeats (GUM, G.4)."""
        if self.freedom is None:
            return 2.0
        return float(stats.t.ppf((1 + EXPANDED_SHARE) / 2, self.freedom))

    @property
    def expanded(self) -> float:
        """U, for about 95 %."""
        return self.coverage_factor * self.standard


def repeatability(runs: Runs, source: str) -> Uncertainty | None:
    """Return the uncertainty of one run from repeats of the same sensors; None with too few repeats.

    Parameters
    ----------
    runs : one sequence of values per sensor.
    source : source of the uncertainty, in words.
    """
    variances = components(runs)
    if variances.repeats < FEWEST_REPEATS or not variances.within:
        return None
    return Uncertainty(sqrt(variances.within), variances.repeats, source)


def risks(bound: Bound, guard: float, uncertainty: Uncertainty) -> Risks | None:
    """Return consumer's and producer's risk of one bound; None if the lot cannot determine them.

    The density of true worst values has the fitted shape, or is the average of the families that the lot may come
    from; its variance is that of the lot less that of the measurement. On a logarithmic scale the uncertainty is
    relative to the geometric mean. ``guard``: width of the rejected band.
    """
    if bound.distribution is Distribution.ANY:
        return None
    if not bound.scale.logarithmic and bound.distribution in (Distribution.SEVERAL, Distribution.HEAVY):
        families = bound.families or (FamilyShare(HEAVIEST, 1.0),)
    else:
        families = (FamilyShare(LOG_NORMAL if bound.scale.logarithmic else NORMAL, 1.0),)
    sums = Risks(0.0, 0.0)
    for family in families:
        family_risks = _risks_of_family(bound, family.family, guard, uncertainty)
        if family_risks is None:
            return None
        sums += Risks(family.share * family_risks.consumer, family.share * family_risks.producer)
    return sums


def _risks_of_family(bound: Bound, name: str, guard: float, uncertainty: Uncertainty) -> Risks | None:
    family, logarithmic = family_of(name)
    sign, mean, variance = bound.scale.sign, bound.parts.mean, bound.parts.deviation**2
    u = uncertainty.standard if uncertainty.freedom is None else sqrt(bound.parts.within or 0.0)
    if bound.scale.logarithmic:
        u = u if uncertainty.freedom is not None else u / exp(sign * mean)
    elif logarithmic:  # moments of a log-normal quantity
        relative_variance = variance / mean**2
        variance, u = log1p(relative_variance), u / (abs(mean) / sqrt(1 + relative_variance))
        mean = sign * (log(abs(mean)) - variance / 2)
    scale, guarded_limit = Scale(sign, logarithmic), bound.limit - sign * guard
    true_variance = variance - u**2
    if not u or true_variance < (_LEAST_SPREAD * u) ** 2 or (logarithmic and min(guarded_limit, bound.limit) <= 0):
        return None
    if name in (NORMAL, LOG_NORMAL):
        family = LargestNormal(bound.independent_values)
    elif sign < 0:
        family = family.mirror()
    family_mean, family_deviation = family.moments()
    unit, limit = sqrt(true_variance) / family_deviation, scale.forward(bound.limit)

    def density(y: Array) -> Array:
        return np.exp(family.log_density((y - mean) / unit + family_mean)) / unit

    return risks_of_bound(density, limit, limit - scale.forward(guarded_limit), u)
