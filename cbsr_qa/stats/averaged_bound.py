"""One bound from several families of distributions, each counting by how well it explains the lot.

No test tells thirty sensors of heavier tails from normal ones, so a limit must not rest on the one family that a test
has not refuted. With prior weights w, evidence e and posterior exceedance P(q > b) of each family, the bound b solves

    Σ w e P(q > b) = error · (Σ_light w e + 0.2 Σ_others w e).

With 1 in place of 0.2 this is the plain average. At 0.2, a lot that is evidently of heavier tails has bounds with a
fifth of the error probability; this makes up for lots of such tails that look normal. The weights were chosen by
simulation, so that normal lots of 30 get bounds about 15 % wider than from the noncentral t; they grow with the lot,
since a larger one costs less width (``benchmarks/limit_promises.py``).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import exp, log
from typing import Final

import numpy as np
from scipy import optimize, stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.families import Contaminated, Family, Gumbel, LargestNormal, Student
from cbsr_qa.stats.family_posterior import Posterior, find_posterior

#: Names of families, as reports write them.
NORMAL, LOG_NORMAL, WEIBULL, HEAVIEST = "normal", "log-normal", "Weibull", "Student 3"
CONTAMINATED: Final = "one in ten scatters six times"
_LIGHT: Final = (NORMAL, LOG_NORMAL, WEIBULL)  #: families without heavy tails on their scale
#: Other families of x, whether of log x, and their prior weights in a lot of 300, relative to all variants of normal
#: and log-normal together.
_OTHERS: Final[dict[str, tuple[Family, bool, float]]] = {
    "Student 5": (Student(5), False, 1.0),
    HEAVIEST: (Student(3), False, 1.0),
    "Gumbel of largest": (Gumbel(+1), False, 0.2),
    "Gumbel of smallest": (Gumbel(-1), False, 0.2),
    CONTAMINATED: (Contaminated(0.1, 6), False, 0.2),
    WEIBULL: (Gumbel(-1), True, 0.3),
}
_FULL_WEIGHT_SENSORS: Final = 300
_EVIDENT_ERROR: Final = 0.2  #: error probability of lots that are evidently of another family, relative
_LARGEST_BOUND: Final = 1e300


def family_of(name: str) -> tuple[Family, bool]:
    """Return a family by its name in a report, and whether it is of log x."""
    if name in (NORMAL, LOG_NORMAL):
        return LargestNormal(), name == LOG_NORMAL
    family, logarithmic, _ = _OTHERS[name]
    return family, logarithmic


@dataclass(frozen=True, slots=True)
class FamilyShare:
    """A family, and its share of the posterior probability."""

    family: str
    share: float


@dataclass(frozen=True, eq=False)
class _Member:
    """A family on a scale: of sign · x, or of sign · log x."""

    name: str
    posterior: Posterior
    values: Array
    logarithmic: bool
    weight: float
    log_evidence: float

    def exceedance(self, bound: float, share: float, sign: int) -> float:
        """Return the probability that the quantile of sign · x lies above a bound."""
        if not self.logarithmic:
            return self.posterior.exceedance(bound, share)
        if sign * bound <= 0:
            return 1.0 if sign > 0 else 0.0
        return self.posterior.exceedance(sign * log(sign * bound), share)

    def scores(self) -> Array:
        """Return the lot's values as normal scores of the likeliest member of the family, (n,)."""
        return self.posterior.family.normal_scores((self.values - self.posterior.location) / self.posterior.scale)


@dataclass(frozen=True, eq=False)
class Average:
    """Families that may explain a lot, on the side of ``sign`` · x."""

    sign: int
    members: tuple[_Member, ...]

    @property
    def odds(self) -> list[float]:
        """Weight times evidence of each member, relative."""
        largest = max(member.log_evidence for member in self.members)
        return [member.weight * exp(member.log_evidence - largest) for member in self.members]

    @property
    def largest_of(self) -> int:
        """Number of independent normal values of which the likeliest normal or log-normal variant is the largest."""
        variants = [
            (odd, member.posterior.family.values)
            for odd, member in zip(self.odds, self.members, strict=True)
            if isinstance(member.posterior.family, LargestNormal)
        ]
        return max(variants)[1] if variants else 1

    def find_bound(self, share: float, error: float) -> float:
        """Return the bound of sign · x above which the quantile of a share lies with at most this probability."""
        odds = self.odds
        is_light = [member.name in _LIGHT or len(self.members) == 1 for member in self.members]
        allowed = error * sum(
            odd * (1.0 if light else _EVIDENT_ERROR) for odd, light in zip(odds, is_light, strict=True)
        )

        def excess(bound: float) -> float:
            tails = (member.exceedance(bound, share, self.sign) for member in self.members)
            return sum(odd * tail for odd, tail in zip(odds, tails, strict=True)) - allowed

        linear = next(member.posterior for member in self.members if not member.logarithmic)
        low, step = linear.location, linear.scale
        while excess(low) < 0:
            low, step = low - step, 2 * step
        high = max(linear.location, low) + linear.scale
        while excess(high) > 0 and high < _LARGEST_BOUND:
            high, step = high + step, 2 * step
        return float(optimize.brentq(excess, low, high, rtol=1e-9)) if high < _LARGEST_BOUND else high

    def nodes(self) -> Iterator[tuple[_Member, Array, Array, Array]]:
        """Yield each member with locations, scales and weights of its posterior; all weights sum to 1."""
        odds = self.odds
        for odd, member in zip(odds, self.members, strict=True):
            locations, scales, weights = member.posterior.nodes()
            yield member, locations, scales, weights * odd / sum(odds)

    def shares(self) -> tuple[FamilyShare, ...]:
        """Return each family's share, of variants under one name together, largest first."""
        sums: dict[str, float] = {}
        for odd, member in zip(self.odds, self.members, strict=True):
            sums[member.name] = sums.get(member.name, 0.0) + odd
        total = sum(sums.values())
        shares = [FamilyShare(name, odd / total) for name, odd in sums.items()]
        return tuple(sorted(shares, key=lambda share: -share.share))

    def p_value(self) -> float:
        """Return the largest p value of Shapiro and Wilk's test, over the families, of their normal scores."""
        return max(float(stats.shapiro(member.scores()).pvalue) for member in self.members)


def average(values: Array, sign: int, largest_of: int = 1, *, positive: bool) -> Average:
    """Weigh all families by a lot's values (n,), of which more than half differ from their median.

    Families of log x are log-normal, and Weibull (log x is Gumbel's of smallest).

    Parameters
    ----------
    sign : +1 for an upper bound, −1 for a lower one.
    largest_of : number of values of a run, of which each value is the worst.
    positive : whether the quantity is, so that families of log x count.
    """
    others_weight = min(len(values) / _FULL_WEIGHT_SENSORS, 1.0)
    scales = [(NORMAL, False), (LOG_NORMAL, True)] if positive else [(NORMAL, False)]
    shapes = [LargestNormal(count) for count in dict.fromkeys((1, largest_of))]
    base_weight = 1 / (len(scales) * len(shapes))
    members = [
        _weigh(values, sign, name, shape, logarithmic, base_weight)
        for name, logarithmic in scales
        for shape in shapes
    ]
    for name, (family, logarithmic, weight) in _OTHERS.items():
        if logarithmic and not positive:
            continue
        variants = [family if sign > 0 else family.mirror()]
        if isinstance(family, Student) and largest_of > 1:
            variants.append(replace(family, values=largest_of))
        share = others_weight * weight / len(variants)
        members += [_weigh(values, sign, name, variant, logarithmic, share) for variant in variants]
    return Average(sign, tuple(members))


def average_heaviest(values: Array, sign: int) -> Average:
    """Take the heaviest tails alone, whatever the lot looks like."""
    return Average(sign, (_weigh(values, sign, HEAVIEST, Student(3), False, 1.0),))


def _weigh(values: Array, sign: int, name: str, family: Family, logarithmic: bool, weight: float) -> _Member:
    on_scale = sign * (np.log(values) if logarithmic else values)
    posterior = find_posterior(on_scale, family)
    log_evidence = posterior.log_evidence
    if logarithmic:  # density of x, and the prior of the location in units of x
        log_evidence += float(np.mean(np.log(values)) - np.sum(np.log(values)))
    return _Member(name, posterior, on_scale, logarithmic, weight, log_evidence)
