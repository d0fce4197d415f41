"""Process capability indices and yield, with confidence intervals.

With the deviation σ̂ within subgroups (short term, ν = N − k degrees of freedom) and s of all values (ν = N − 1),

    Cp = (U − L)/6σ̂,  Cpk = min(U − x̄, x̄ − L)/3σ̂,  Pp and Ppk the same with s;  one limit: that side's index only.

Intervals, for normal values: Cp exact by χ² (e-Handbook 7.1.6); an index of one limit exact by the noncentral t,
3√N Ĉ ~ t'_ν(3√N C); Cpk of two limits by Bissell 1990, Ĉ ± z √(1/9N + Ĉ²/2ν).

With two limits and several values per run, the lower limit judges a run's least value l and the upper one its
greatest g, with joint (Bonferroni) intervals:

    Cpk = min((U − ḡ)/3σ_g, (l̄ − L)/3σ_l),  Cp = (U − L − (ḡ − l̄))/(3σ_g + 3σ_l).

Yield by the score interval of Wilson 1927, as in e-Handbook 7.2.4.1.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import fsum, inf, sqrt

import numpy as np
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.intervals import noncentrality
from cbsr_qa.stats.samples import Interval, constant, sample, share, subtract_mean


@dataclass(frozen=True, slots=True)
class Index:
    """A capability index without unit, the ends of its interval, and the method of the interval."""

    value: float
    low: float
    high: float
    method: str


@dataclass(frozen=True, slots=True)
class Capability:
    """Indices of one metric.

    Parameters
    ----------
    count : N.
    mean : mean of all values.
    within, overall : σ̂ and s, in the values' unit.
    cp, pp : None where there is one limit.
    """

    count: int
    mean: float
    within: float
    overall: float
    cp: Index | None
    cpk: Index
    pp: Index | None
    ppk: Index


@dataclass(frozen=True, slots=True)
class _Spread:
    """A deviation, its degrees of freedom, and the number of values behind the mean."""

    deviation: float
    freedom: int
    count: int


def capability(
    groups: Sequence[Iterable[float]],
    *,
    lower: float | None = None,
    upper: float | None = None,
    confidence: float = 0.95,
    what: str = "values",
) -> Capability:
    """Return Cp, Cpk, Pp and Ppk of values in subgroups (one subgroup: both pairs are the same).

    Parameters
    ----------
    groups : values of each subgroup made under the same conditions (batch, day), in the unit of the limits.
    lower, upper : limits; at least one.
    what : the metric, for messages.

    Raises
    ------
    NumericsError
        No limit, limits in the wrong order, too few or missing values, or no spread.
    """
    _check_limits(lower, upper, what)
    share(confidence, "confidence")
    arrays = [sample(values, f"{what}, subgroup {index + 1}") for index, values in enumerate(groups)]
    pooled = sample(np.concatenate(arrays) if arrays else (), what, least=2, spread=True)
    within_spread, overall_spread = _within(arrays, what), _within([pooled], what)
    mean, _ = subtract_mean(pooled)
    limits = mean, lower, upper, confidence
    return Capability(
        count=len(pooled),
        mean=mean,
        within=within_spread.deviation,
        overall=overall_spread.deviation,
        cp=_both(within_spread, *limits[1:]),
        cpk=_nearest(within_spread, *limits),
        pp=_both(overall_spread, *limits[1:]),
        ppk=_nearest(overall_spread, *limits),
    )


def capability_of_extremes(
    least: Sequence[Iterable[float]],
    greatest: Sequence[Iterable[float]],
    *,
    lower: float,
    upper: float,
    confidence: float = 0.95,
    what: str = "values",
) -> Capability:
    """Return the indices of runs of several values each, judged by two limits.

    Mean and deviations are averages of both sides; coverage of the intervals is at least as stated.

    Parameters
    ----------
    least, greatest : values of each subgroup's runs, in the same order, in the unit of the limits.
    lower, upper, what : see :func:`capability`.

    Raises
    ------
    NumericsError
        As for :func:`capability`, on either side.
    """
    _check_limits(lower, upper, what)
    share(confidence, "confidence")
    sides: list[tuple[float, _Spread, _Spread]] = []
    for groups, extreme in ((least, "least"), (greatest, "greatest")):
        arrays = [sample(values, f"{what}, {extreme} of subgroup {index + 1}") for index, values in enumerate(groups)]
        pooled = sample(np.concatenate(arrays) if arrays else (), f"{what}, {extreme}", least=2, spread=True)
        sides.append((subtract_mean(pooled)[0], _within(arrays, what), _within([pooled], what)))
    (low_mean, *low), (high_mean, *high) = sides
    value_ranges = np.concatenate([np.asarray(list(group), float) for group in greatest])
    value_ranges = value_ranges - np.concatenate([np.asarray(list(group), float) for group in least])
    pairs = list(zip(low, high, strict=True))
    cp, pp = (
        _room_of_both(low_spread, high_spread, value_ranges, upper - lower, confidence)
        for low_spread, high_spread in pairs
    )
    cpk, ppk = (
        _nearer(low_spread, high_spread, low_mean - lower, upper - high_mean, confidence)
        for low_spread, high_spread in pairs
    )
    within_deviation, overall_deviation = (
        (low_spread.deviation + high_spread.deviation) / 2 for low_spread, high_spread in pairs
    )
    return Capability(
        len(value_ranges), (low_mean + high_mean) / 2, within_deviation, overall_deviation, cp, cpk, pp, ppk
    )


def _check_limits(lower: float | None, upper: float | None, what: str) -> None:
    if lower is None and upper is None:
        raise NumericsError(f"{what}: capability needs at least one limit")
    if not (-inf if lower is None else lower) < (inf if upper is None else upper):
        raise NumericsError(f"{what}: the lower limit {lower} is not below the upper one {upper}")


def _within(arrays: Sequence["np.ndarray[tuple[int, ...], np.dtype[np.float64]]"], what: str) -> _Spread:
    """Pool the deviation within subgroups, √(ΣΣ(x − x̄_g)²/(N − k))."""
    count = sum(map(len, arrays))
    freedom = count - len(arrays)
    if freedom < 1:
        raise NumericsError(f"{what}: every subgroup has one value", remedy="give all values as one subgroup")
    if all(constant(array) for array in arrays):
        raise NumericsError(f"{what}: values within the subgroups do not differ: there is no short-term spread")
    squares = fsum(square for array in arrays for square in subtract_mean(array)[1] ** 2)
    return _Spread(sqrt(squares / freedom), freedom, count)


def _both(spread: _Spread, lower: float | None, upper: float | None, confidence: float) -> Index | None:
    if lower is None or upper is None:
        return None
    value, tail = (upper - lower) / (6 * spread.deviation), (1 - confidence) / 2
    low, high = (sqrt(float(stats.chi2.ppf(p, spread.freedom)) / spread.freedom) for p in (tail, 1 - tail))
    return Index(value, value * low, value * high, "chi-square, exact for normal values")


def _nearest(spread: _Spread, mean: float, lower: float | None, upper: float | None, confidence: float) -> Index:
    room = [upper - mean] if upper is not None else []
    room += [mean - lower] if lower is not None else []
    value = min(room) / (3 * spread.deviation)
    if len(room) == 1:
        low, high = _exact(value, spread, confidence)
        return Index(value, low, high, "noncentral t, exact for normal values")
    z = float(stats.norm.isf((1 - confidence) / 2))
    half_width = z * sqrt(1 / (9 * spread.count) + value**2 / (2 * spread.freedom))
    return Index(value, value - half_width, value + half_width, "Bissell 1990, for normal values")


def _nearer(low: _Spread, high: _Spread, below: float, above: float, confidence: float) -> Index:
    """Return the lesser of both sides' indices; its interval ends are the lesser of the joint intervals' ends."""
    side_confidence = 1 - (1 - confidence) / 2
    values = [below / (3 * low.deviation), above / (3 * high.deviation)]
    ends = [_exact(value, spread, side_confidence) for value, spread in zip(values, (low, high), strict=True)]
    low_end, high_end = (min(side) for side in zip(*ends, strict=True))
    return Index(min(values), low_end, high_end, "noncentral t of both sides, Bonferroni, for normal values")


def _room_of_both(low: _Spread, high: _Spread, apart: Array, width: float, confidence: float) -> Index:
    """Return Cp of both sides, with an interval from those of both deviations and of ḡ − l̄."""
    tail = (1 - confidence) / 6
    error = float(apart.std(ddof=1)) / sqrt(len(apart))
    half_width = float(stats.t.isf(tail, len(apart) - 1)) * error
    room = width - float(apart.mean())
    wide_sigma, narrow_sigma = (
        sum(3 * side.deviation * sqrt(side.freedom / float(stats.chi2.ppf(p, side.freedom))) for side in (low, high))
        for p in (tail, 1 - tail)
    )
    ratios = [
        end / six_sigma for end in (room - half_width, room + half_width) for six_sigma in (wide_sigma, narrow_sigma)
    ]
    value = room / (3 * (low.deviation + high.deviation))
    return Index(value, min(ratios), max(ratios), "χ² of both sides and t, Bonferroni")


def _exact(value: float, spread: _Spread, confidence: float) -> tuple[float, float]:
    """Return both ends of the interval of an index of one limit."""
    scale, tail = 3 * sqrt(spread.count), (1 - confidence) / 2
    low, high = (noncentrality(scale * value, spread.freedom, p) / scale for p in (1 - tail, tail))
    return low, high


@dataclass(frozen=True, slots=True)
class Yield:
    """A proportion of sensors, between 0 and 1."""

    passed: int
    count: int
    value: float
    wilson: Interval


def pass_rate(passed: int, count: int, *, confidence: float = 0.95) -> Yield:
    """Return the share that passed.

    Raises
    ------
    NumericsError
        Nothing was counted, or more passed than were counted.
    """
    share(confidence, "confidence")
    if count < 1 or not 0 <= passed <= count:
        raise NumericsError(f"yield: {passed} of {count} is not a yield", remedy="count at least one sensor")
    low, high = stats.binomtest(passed, count).proportion_ci(confidence, method="wilson")
    return Yield(passed, count, passed / count, Interval(float(low), float(high), confidence))
