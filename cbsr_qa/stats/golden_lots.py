"""Tolerance limits from a golden lot: share of good sensors within a limit, with stated confidence.

Sensors are the unit. A run fails by its worst value, so each run counts with its worst value, and a bound must hold
the worst value of a stated share of good sensors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, exp, floor, log, log10, sqrt

import numpy as np
from scipy import stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.averaged_bound import Average, FamilyShare, average, average_heaviest
from cbsr_qa.stats.intervals import count_needed, factor_of_quantile, spacings_outside
from cbsr_qa.stats.lot_shapes import Distribution, Fit, far_out, fits_worst_of
from cbsr_qa.stats.variance_components import Components, components, telling_runs

#: Number of sensors below which no distribution is tested.
FEWEST_SENSORS = 3
#: p-value below which a normal or log-normal distribution is rejected: at 0.05 one of a recipe's dozen limits would
#: be refused for every second lot that is normal.
LEVEL = 0.01
_LARGEST = 1e150
_LEAST_SPREAD = 1e-12  #: of the mean; less is rounding
_MOST_DECIMALS = 300
_LARGEST_LOG = 690.0  #: its exponential is still finite

#: Values of a lot: one sequence per sensor, one number per run.
Runs = Sequence[Sequence[float]]


@dataclass(frozen=True, slots=True)
class Ask:
    """Requirements on the limits.

    Parameters
    ----------
    coverage, confidence : shares between 0 and 1.
    lower, upper : whether each bound is required; at least one is.
    distribution : distribution to use; normal and log-normal unless the lot rejects it. None: no distribution if the
        lot is large enough for order statistics, else an average of families.
    """

    coverage: float
    confidence: float
    lower: bool
    upper: bool
    distribution: Distribution | None = None

    @property
    def sides(self) -> int:
        return self.lower + self.upper


@dataclass(frozen=True, slots=True)
class Scale:
    """Transformation that makes a bound an upper one of a normal quantity: y = ± x or ± log x."""

    sign: int
    logarithmic: bool

    def forward(self, x: float) -> float:
        """Return y of a value."""
        return self.sign * (log(x) if self.logarithmic else x)

    def inverse(self, y: float) -> float:
        """Return the value of y."""
        return exp(min(self.sign * y, _LARGEST_LOG)) if self.logarithmic else self.sign * y


@dataclass(frozen=True, slots=True)
class Narrower:
    """Bound from another distribution that is not rejected either."""

    distribution: Distribution
    limit: float


@dataclass(frozen=True, slots=True)
class Bound:
    """One proposed bound, and its basis.

    Parameters
    ----------
    limit : rounded outwards to a hundredth of its distance from the mean.
    distribution : distribution of single values.
    independent_values : the sensors' worst values are modelled as the largest of this many independent ones: all of a
        run, or 1 if that is rejected and worst values are themselves normal, as when values of a sensor are
        correlated.
    tests : tests of the distributions tried, in order.
    scale : scale of ``parts``.
    parts : variance components of the sensors' worst values on that scale.
    factor : k of mean + k deviation on that scale; None for order statistics.
    families : shares of the families that the lot may come from, largest first; empty if one was stated, or none is
        needed.
    worst_mean, worst_deviation : mean and single-run deviation of the sensors' worst values, in their unit.
    """

    limit: float
    distribution: Distribution
    independent_values: int
    tests: tuple[Fit, ...]
    scale: Scale
    parts: Components
    factor: float | None
    worst_mean: float = 0.0
    worst_deviation: float = 0.0
    narrower: tuple[Narrower, ...] = ()
    families: tuple[FamilyShare, ...] = ()


@dataclass(frozen=True, slots=True)
class LotLimits:
    """Bounds of one measurement from a lot, or the reason for none.

    Parameters
    ----------
    lower, upper : None if not requested, or refused.
    why : reason for a refusal; empty if there are bounds.
    far_out : indices of sensors far from the others, on the scale used.
    """

    lower: Bound | None = None
    upper: Bound | None = None
    why: str = ""
    far_out: tuple[int, ...] = ()


def lot_limits(smallest: Runs, largest: Runs, values: int, ask: Ask) -> LotLimits:
    """Propose bounds for a measurement.

    Where fewer than four runs repeat a sensor only first runs count. With one value per run, two bounds are mean ± k
    s; with several, they are two one-sided bounds, each with half the share outside and half the error probability
    (Bonferroni).

    Parameters
    ----------
    smallest, largest : smallest and largest value of each run of each sensor.
    values : number of values of a run; 1 if both are the same.
    """
    smallest, largest, count = telling_runs(smallest), telling_runs(largest), len(largest)
    if count < FEWEST_SENSORS:
        return LotLimits(why=f"too few sensors: {count}; at least {FEWEST_SENSORS} are needed")
    for runs in ([smallest] if ask.lower else []) + ([largest] if ask.upper else []):
        if why := _explain_no_spread(runs):
            return LotLimits(why=why)
    # Distributions to try: a quantity that can be negative is not log-normal.
    positive = min(min(sensor) for sensor in smallest) > 0
    possible = (Distribution.NORMAL, Distribution.LOG_NORMAL) if positive else (Distribution.NORMAL,)
    distributions = tuple(distribution for distribution in possible if ask.distribution in (None, distribution))
    lower = _find_bound(smallest, distributions, values, ask, -1) if ask.lower else None
    upper = _find_bound(largest, distributions, values, ask, +1) if ask.upper else None
    far_sensors = _find_far_out(smallest, largest, (lower, upper))
    refusal = next((side for side in (lower, upper) if isinstance(side, str)), "")
    if refusal:
        return LotLimits(why=refusal, far_out=far_sensors)
    assert not isinstance(lower, str)
    assert not isinstance(upper, str)
    return LotLimits(lower, upper, far_out=far_sensors)


def _explain_no_spread(runs: Runs) -> str:
    """Say why the values' spread is unusable; empty otherwise."""
    largest = max(abs(x) for sensor in runs for x in sensor)
    if largest > _LARGEST:
        return f"values beyond {_LARGEST:g} are too large to be squared"
    if 0 < largest < 1 / _LARGEST:
        return f"values below {1 / _LARGEST:g} are too small to be squared"
    variances = components(runs)
    if variances.between**0.5 <= _LEAST_SPREAD * abs(variances.mean):
        return f"every sensor has {variances.mean:.6g}: limits cannot be derived without spread"
    return ""


def _find_bound(runs: Runs, looked_at: tuple[Distribution, ...], values: int, ask: Ask, sign: int) -> Bound | str:
    """Return the bound of the asked distribution, or of all that the lot may come from, or the reason for none."""
    if ask.distribution is Distribution.HEAVY and not _are_mostly_equal(runs):
        heaviest = average_heaviest(_mean_of_sensors(runs), sign)
        return _round_bound(_average_bound(runs, heaviest, values, ask), runs)
    is_large = spacings_outside(len(runs), ask.coverage, ask.confidence) >= ask.sides
    if ask.distribution is Distribution.ANY or (ask.distribution is None and is_large):
        return _order_statistic_bound(runs, ask, sign, [])
    candidates, fits = _fit_distributions(runs, looked_at, values, ask, sign)
    families: tuple[FamilyShare, ...] = ()
    if ask.distribution is None and not _are_mostly_equal(runs):
        is_positive = Distribution.LOG_NORMAL in looked_at
        lot = average(_mean_of_sensors(runs), sign, values, positive=is_positive)
        families = lot.shares()
        p_value = lot.p_value()
        fits.append(Fit(p_value, p_value < LEVEL, Distribution.SEVERAL))
        if candidates or p_value >= LEVEL:
            candidates.append(_average_bound(runs, lot, values, ask))
    if not candidates:
        return _order_statistic_bound(runs, ask, sign, fits)
    *narrower, widest = sorted(candidates, key=lambda bound: sign * bound.limit)
    narrower_bounds = tuple(Narrower(bound.distribution, bound.limit) for bound in narrower)
    widest = replace(widest, tests=tuple(fits), narrower=narrower_bounds, families=families)
    return _round_bound(widest, runs)


def _fit_distributions(
    runs: Runs, looked_at: tuple[Distribution, ...], values: int, ask: Ask, sign: int
) -> tuple[list[Bound], list[Fit]]:
    """Return the bounds of normal and log-normal distributions that are not rejected, and all tests."""
    candidates: list[Bound] = []
    fits: list[Fit] = []
    for distribution in looked_at:
        scale = Scale(sign, distribution is Distribution.LOG_NORMAL)
        scaled_runs = [[scale.forward(x) for x in sensor] for sensor in runs]
        means = _mean_of_sensors(scaled_runs)
        for independent in dict.fromkeys((values, 1)):
            fit = replace(fits_worst_of(means, independent, LEVEL), distribution=distribution)
            fits.append(fit)
            if not fit.refuted:
                variance_components = components(scaled_runs)
                factor = _factor(variance_components, independent, values, ask)
                limit = scale.inverse(variance_components.mean + factor * variance_components.deviation)
                candidates.append(Bound(limit, distribution, independent, (), scale, variance_components, factor))
                break
    return candidates, fits


def _average_bound(runs: Runs, lot: Average, values: int, ask: Ask) -> Bound:
    """Return the bound of an average of families; not rounded.

    Families act on sensors' means: they stretch the factor of normal values, which knows of repeated runs.
    """
    scale = Scale(lot.sign, False)
    parts = components([[scale.forward(x) for x in sensor] for sensor in runs])
    share = ask.coverage if ask.sides == 1 else (1 + ask.coverage) / 2
    error = (1 - ask.confidence) / (1 if ask.sides == 1 or values == 1 else 2)
    normal_quantile = float(stats.norm.ppf(share))
    normal_factor = factor_of_quantile(normal_quantile, 1 - error, parts.sensors, parts.sensors - 1)
    stretch = (lot.find_bound(share, error) - parts.mean) / (normal_factor * sqrt(parts.between))
    factor = stretch * _factor(parts, 1, values, ask)
    is_heavy = ask.distribution is Distribution.HEAVY
    return Bound(
        limit=lot.sign * (parts.mean + factor * parts.deviation),
        distribution=Distribution.HEAVY if is_heavy else Distribution.SEVERAL,
        independent_values=lot.largest_of,
        tests=(),
        scale=scale,
        parts=parts,
        factor=factor,
    )


def _mean_of_sensors(runs: Runs) -> Array:
    return np.array([np.mean(sensor) for sensor in runs])


def _are_mostly_equal(runs: Runs) -> bool:
    """Whether more than half of the sensors have one value: no family has a scale then."""
    means = _mean_of_sensors(runs)
    return not np.median(np.abs(means - np.median(means)))


def _factor(parts: Components, independent: int, values: int, ask: Ask) -> float:
    if ask.sides == 1:
        return parts.quantile_factor(ask.coverage, ask.confidence, independent)
    if values == 1:
        return parts.interval_factor(ask.coverage, ask.confidence)
    return parts.quantile_factor((1 + ask.coverage) / 2, (1 + ask.confidence) / 2, independent)


def _order_statistic_bound(runs: Runs, ask: Ask, sign: int, fits: list[Fit]) -> Bound | str:
    """Return the order statistic that bounds the share for any distribution; the worst run of a sensor counts."""
    worst = sorted(max(sign * x for x in sensor) for sensor in runs)
    spacings = spacings_outside(len(worst), ask.coverage, ask.confidence)
    if spacings < ask.sides:
        sensor_count = count_needed(ask.coverage, ask.confidence, ask.sides)
        return f"{_why_ordered(fits)}distribution-free limits need {sensor_count} sensors; there are {len(worst)}"
    scale, limit = Scale(sign, False), sign * worst[-(spacings // ask.sides)]
    variances = components([[sign * x for x in sensor] for sensor in runs])
    return _round_bound(Bound(limit, Distribution.ANY, 1, tuple(fits), scale, variances, None), runs)


def _why_ordered(fits: list[Fit]) -> str:
    """Describe the rejected distributions, each with the better of its tests."""
    best: dict[Distribution, float] = {}
    for fit in fits:
        best[fit.distribution] = max(fit.p_value, best.get(fit.distribution, 0.0))
    refuted = ", nor ".join(f"{name} (p = {p_value:.2g})" for name, p_value in best.items())
    return f"the values are not {refuted}, and " if refuted else ""


def _round_bound(bound: Bound, runs: Runs) -> Bound:
    raw = components(runs)
    limit = outward(bound.limit, raw.mean, bound.scale.sign)
    return replace(bound, limit=limit, worst_mean=raw.mean, worst_deviation=raw.deviation)


def outward(limit: float, mean: float, sign: int) -> float:
    """Round a limit away from the mean, to a hundredth of its distance from it."""
    distance = abs(limit - mean)
    if not distance:
        return limit
    decimals = min(2 - floor(log10(distance)), _MOST_DECIMALS)
    step = 10.0**decimals
    steps = limit * step
    whole_steps = ceil(steps - 1e-9) if sign > 0 else floor(steps + 1e-9)
    return round(whole_steps / step, max(decimals, 0))


def _find_far_out(smallest: Runs, largest: Runs, bounds: Sequence[Bound | str | None]) -> tuple[int, ...]:
    sensors: set[int] = set()
    for runs, bound in zip((smallest, largest), bounds, strict=True):
        if bound is None:
            continue
        means = [float(np.mean(sensor)) for sensor in runs]
        is_log_normal = isinstance(bound, Bound) and bound.scale.logarithmic
        sensors |= set(far_out([log(x) for x in means] if is_log_normal else means))
    return tuple(sorted(sensors))
