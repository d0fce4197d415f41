"""How often proposed limits keep their promise, by what the sensors of the lot are distributed like.

``python -m benchmarks.limit_promises --lots 1000`` draws lots of one run a sensor and proposes an upper limit that at
least 99 % of sensors meet, with 95 % confidence. Prints, of each family and size of lot: the share of lots for which
a limit is proposed, the share of proposed limits that keep the promise, and their mean distance from the lot's mean
over that of one distribution's: the widest of normal and log-normal of those that Shapiro and Wilk's test does not
reject. ``--sides 2`` proposes limits on both sides. ``--best 1.15`` prints instead what no rule can surpass: how many
lots of Student's t with 3 degrees of freedom keep the promise by the best rule that widens the limits of normal lots
by 15 % on average.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from math import inf, nan

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.stats.families import LargestNormal, Student
from cbsr_qa.stats.family_posterior import find_posterior
from cbsr_qa.stats.golden_lots import Ask, Bound, LotLimits, lot_limits
from cbsr_qa.stats.intervals import one_sided_factor
from cbsr_qa.stats.lot_shapes import Distribution

Array = NDArray[np.float64]
COVERAGE, CONFIDENCE = 0.99, 0.95
_POPULATION = 2_000_000


def _mix(random: np.random.Generator, count: int, share: float, ratio: float, shift: float) -> Array:
    """Draw standard normal values of which a share scatters ``ratio`` times as much, about ``shift``."""
    is_other = random.random(count) < share
    values: Array = random.normal(size=count) * np.where(is_other, ratio, 1.0) + np.where(is_other, shift, 0.0)
    return values


#: Families of the promise, and others that had no part in the choice of weights.
FAMILIES: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "normal": lambda random, count: random.normal(size=count),
    "normal, 20 ± 1": lambda random, count: random.normal(20, 1, count),
    "log-normal 0.25": lambda random, count: np.exp(random.normal(0, 0.25, count)),
    "log-normal 0.5": lambda random, count: np.exp(random.normal(0, 0.5, count)),
    "t5": lambda random, count: random.standard_t(5, count),
    "t5 + 20": lambda random, count: 20 + random.standard_t(5, count),
    "t3": lambda random, count: random.standard_t(3, count),
    "t3 + 20": lambda random, count: 20 + random.standard_t(3, count),
    "90/10, twice the scatter": lambda random, count: _mix(random, count, 0.1, 2, 0),
    "90/10, 3 times the scatter": lambda random, count: _mix(random, count, 0.1, 3, 0),
    "90/10, 3 times, + 20": lambda random, count: 20 + _mix(random, count, 0.1, 3, 0),
    "90/10, shifted by 3": lambda random, count: _mix(random, count, 0.1, 1, 3),
    "Weibull 1.5": lambda random, count: random.weibull(1.5, count),
    "gamma 2": lambda random, count: random.gamma(2, size=count),
    "Gumbel": lambda random, count: random.gumbel(size=count),
    "logistic": lambda random, count: random.logistic(size=count),
    "t4 + 10": lambda random, count: 10 + random.standard_t(4, count),
    "Laplace": lambda random, count: random.laplace(size=count),
    "exponential": lambda random, count: random.exponential(size=count),
    "uniform": lambda random, count: random.random(count),
    "90/10, 5 times the scatter": lambda random, count: _mix(random, count, 0.1, 5, 0),
}


@dataclass(frozen=True)
class Kept:
    """Shares of lots, and the mean ratio of distances where both rules propose (NaN if they never do)."""

    proposed: float
    kept: float
    width: float
    kept_of_one_distribution: float
    proposed_of_one_distribution: float


def measure(family: str, sensors: int, lots: int, sides: int = 1) -> Kept:
    """Propose limits for many lots of a family."""
    draw = FAMILIES[family]
    population = np.sort(draw(np.random.default_rng([10, _POPULATION]), _POPULATION))
    held: tuple[list[bool], list[bool]] = ([], [])
    widths = []
    for seed in range(lots):
        lot = draw(np.random.default_rng([11, list(FAMILIES).index(family), sensors, seed]), sensors)
        runs = lot[:, None].tolist()
        several = lot_limits(runs, runs, 1, _ask(sides, None))
        single = _widest([lot_limits(runs, runs, 1, _ask(sides, one)) for one in _possible(lot)])
        for limits, outcomes in zip((several, single), held, strict=True):
            if not limits.why:
                outcomes.append(_content(limits, population) >= COVERAGE)
        if not several.why and not single.why:
            widths.append(_distance(several, lot) / _distance(single, lot))
    shares = [float(np.mean(outcomes)) if outcomes else nan for outcomes in held]
    width = float(np.mean(widths)) if widths else nan
    return Kept(len(held[0]) / lots, shares[0], width, shares[1], len(held[1]) / lots)


def find_best_share(sensors: int, lots: int, width: float) -> float:
    """Return the share of lots of t3 kept by the best rule with this mean factor on normal lots, relative to theirs.

    By Neyman and Pearson's lemma the rule takes, for each lot, the factor k ≥ 1 that minimises k + λ r P(q > b(k)), r
    the ratio of the evidence of t3 and normal, P the posterior of t3's quantile; λ sets the mean width.
    """
    factors = np.linspace(1.0, 3.0, 81)
    normal_factor = one_sided_factor(COVERAGE, CONFIDENCE, sensors, sensors - 1)
    costs, needed = [], np.empty(lots)
    for heavy in (False, True):
        risks = np.empty((lots, len(factors)))
        for row in range(lots):
            random = np.random.default_rng([12, heavy, sensors, row])
            lot = random.standard_t(3, sensors) if heavy else random.normal(size=sensors)
            normal, student = (find_posterior(lot, family) for family in (LargestNormal(), Student(3)))
            mean, unit = float(lot.mean()), normal_factor * float(lot.std(ddof=1))
            ratio = np.exp(student.log_evidence - normal.log_evidence)
            risks[row] = [ratio * student.exceedance(mean + k * unit, COVERAGE) for k in factors]
            if heavy:
                needed[row] = (Student(3).quantile(COVERAGE) - mean) / unit
        costs.append(risks)

    def choose(weight: float, risks: Array) -> Array:
        chosen: Array = factors[np.argmin(factors + weight * risks, axis=1)]
        return chosen

    low, high = 0.0, 1000.0
    for _ in range(40):
        weight = (low + high) / 2
        low, high = (weight, high) if choose(weight, costs[0]).mean() < width else (low, weight)
    return float(np.mean(choose(low, costs[1]) >= needed))


def _ask(sides: int, distribution: Distribution | None) -> Ask:
    return Ask(COVERAGE, CONFIDENCE, lower=sides == 2, upper=True, distribution=distribution)


def _possible(lot: Array) -> tuple[Distribution, ...]:
    both = (Distribution.NORMAL, Distribution.LOG_NORMAL)
    return both if lot.min() > 0 else both[:1]


def _widest(limits: list[LotLimits]) -> LotLimits:
    """Return the widest bound of each side; where one distribution is rejected, that of the other."""
    proposed = [one for one in limits if not one.why]
    if not proposed:
        return limits[0]

    def pick(bounds: list[Bound | None], sign: int) -> Bound | None:
        known = [bound for bound in bounds if bound is not None]
        return max(known, key=lambda bound: sign * bound.limit) if known else None

    return LotLimits(pick([one.lower for one in proposed], -1), pick([one.upper for one in proposed], +1))


def _ends(limits: LotLimits) -> tuple[float, float]:
    return (
        -inf if limits.lower is None else limits.lower.limit,
        inf if limits.upper is None else limits.upper.limit,
    )


def _content(limits: LotLimits, population: Array) -> float:
    low, high = np.searchsorted(population, _ends(limits))
    return float(high - low) / len(population)


def _distance(limits: LotLimits, lot: Array) -> float:
    low, high = _ends(limits)
    return high - float(lot.mean()) if low == -inf else high - low


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lots", type=int, default=1000)
    parser.add_argument("--sensors", type=int, action="append")
    parser.add_argument("--sides", type=int, choices=(1, 2), default=1)
    parser.add_argument("--family", choices=FAMILIES, action="append")
    parser.add_argument("--best", type=float, metavar="WIDTH")
    options = parser.parse_args()
    if options.best is not None:
        for sensors in options.sensors or (30, 100):
            share = find_best_share(sensors, options.lots, options.best)
            sys.stdout.write(f"{sensors} sensors: at most {100 * share:.0f} % of lots of t3\n")
        return
    columns = ("sensors are", "lot of", "proposed", "kept", "width", "kept by one distribution", "proposed by it")
    sys.stdout.write(f"| {' | '.join(columns)} |\n|{' --- |' * len(columns)}\n")
    for family in options.family or FAMILIES:
        for sensors in options.sensors or (30, 100):
            one = measure(family, sensors, options.lots, options.sides)
            cells = (
                f"{100 * one.proposed:.1f} %",
                f"{100 * one.kept:.1f} %",
                f"{one.width:.2f}",
                f"{100 * one.kept_of_one_distribution:.1f} %",
                f"{100 * one.proposed_of_one_distribution:.1f} %",
            )
            sys.stdout.write(f"| {family} | {sensors} | {' | '.join(cells)} |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
