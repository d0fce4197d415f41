"""Process capability indices and yield, with confidence intervals.

With the deviation σ̂ within subgroups (short term, ν = N − k degrees of freedom) and s of all values (ν = N − 1),

    Cp = (U − L)/6σ̂,  Cpk = min(U − x̄, x̄ − L)/3σ̂,  Pp and Ppk the same with s;  one limit: that side's index only.

Intervals, for normal values of one subgroup: Cp exact by χ² (e-Handbook 7.1.6); an index of one limit exact by the
noncentral t, 3√N Ĉ ~ t'_ν(3√N C); Cpk of two limits by Bissell 1990, Ĉ ± z √(1/9N + Ĉ²/2ν).

Several subgroups are a sample of further ones, x = μ + subgroup + value. Cp is exact as before; the others have
generalised intervals (Krishnamoorthy & Mathew 2009, chapter 5) of

    σ_w² = S_w/χ²_{N−k},  V = (k − 1) var(x̄_g)/χ²_{k−1},  σ_b² = max(V − σ_w²/ñ, 0),  ñ the harmonic mean size,
    μ = x̄ + Z √(σ_b² Σn_g²/N² + σ_w²/N),  overall σ² = σ_b² + σ_w².

With two limits and several values per run, the lower limit judges a run's least value l and the upper one its
greatest g, with joint (Bonferroni) intervals:

    Cpk = min((U − ḡ)/3σ_g, (l̄ − L)/3σ_l),  Cp = (U − L − (ḡ − l̄))/(3σ_g + 3σ_l).

Yield by the score interval of Wilson 1927, as in e-Handbook 7.2.4.1.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import fsum, inf, sqrt
from typing import Final

import numpy as np
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.intervals import noncentrality
from cbsr_qa.stats.normality import Normality, check_normality
from cbsr_qa.stats.samples import Interval, constant, sample, share, subtract_mean

_DRAWS: Final = 20_000
_SUBGROUPS: Final = "generalised, subgroups are a sample of further ones, for normal values"


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
    normality : test of all values; None for fewer than three. The indices, and shares beyond the limits that are
        computed from them, hold for normal values only.
    """

    count: int
    mean: float
    within: float
    overall: float
    cp: Index | None
    cpk: Index
    pp: Index | None
    ppk: Index
    normality: Normality | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Spread:
    """A deviation, and what its intervals rest on.

    Parameters
    ----------
    freedom : its degrees of freedom; None if it is not distributed like χ, and ``deviations`` tell.
    count : number of values behind the mean.
    means, deviations : draws of the process mean and of the deviation, for several subgroups; None for one.
    """

    deviation: float
    freedom: int | None
    count: int
    means: Array | None = None
    deviations: Array | None = None

    def ends(self, tail: float) -> tuple[float, float]:
        """Return the interval of the deviation with this probability beyond each end."""
        if self.freedom is None:
            assert self.deviations is not None
            low, high = np.quantile(self.deviations, (tail, 1 - tail))
            return float(low), float(high)
        low, high = (
            self.deviation * sqrt(self.freedom / float(stats.chi2.isf(p, self.freedom))) for p in (tail, 1 - tail)
        )
        return low, high


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
    mean, within_spread, overall_spread = _find_spreads(arrays, what)
    pooled = np.concatenate(arrays)
    limits = mean, lower, upper, confidence
    return Capability(
        count=len(pooled),
        mean=mean,
        within=within_spread.deviation,
        overall=overall_spread.deviation,
        cp=_evaluate_both(within_spread, *limits[1:]),
        cpk=_nearest(within_spread, *limits),
        pp=_evaluate_both(overall_spread, *limits[1:]),
        ppk=_nearest(overall_spread, *limits),
        normality=check_normality(pooled),
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
    arrays_of_sides: list[list[Array]] = []
    for groups, extreme in ((least, "least"), (greatest, "greatest")):
        arrays = [sample(values, f"{what}, {extreme} of subgroup {index + 1}") for index, values in enumerate(groups)]
        sides.append(_find_spreads(arrays, f"{what}, {extreme}", what))
        arrays_of_sides.append(arrays)
    (low_mean, *low), (high_mean, *high) = sides
    value_ranges = [most - few for few, most in zip(*arrays_of_sides, strict=True)]
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
    tests = [test for arrays in arrays_of_sides if (test := check_normality(np.concatenate(arrays))) is not None]
    mean, normality = (low_mean + high_mean) / 2, min(tests, key=lambda test: test.p_value, default=None)
    deviations = within_deviation, overall_deviation
    return Capability(sum(map(len, value_ranges)), mean, *deviations, cp, cpk, pp, ppk, normality)


def _check_limits(lower: float | None, upper: float | None, what: str) -> None:
    if lower is None and upper is None:
        raise NumericsError(f"{what}: capability needs at least one limit")
    if not (-inf if lower is None else lower) < (inf if upper is None else upper):
        raise NumericsError(f"{what}: the lower limit {lower} is not below the upper one {upper}")


def _pool_within(arrays: Sequence["np.ndarray[tuple[int, ...], np.dtype[np.float64]]"], what: str) -> _Spread:
    """Pool the deviation within subgroups, √(ΣΣ(x − x̄_g)²/(N − k))."""
    count = sum(map(len, arrays))
    freedom = count - len(arrays)
    if freedom < 1:
        raise NumericsError(f"{what}: every subgroup has one value", remedy="give all values as one subgroup")
    if all(constant(array) for array in arrays):
        raise NumericsError(f"{what}: values within the subgroups do not differ: there is no short-term spread")
    squares = fsum(square for array in arrays for square in subtract_mean(array)[1] ** 2)
    return _Spread(sqrt(squares / freedom), freedom, count)


def _find_spreads(arrays: Sequence[Array], what: str, subgroup: str = "") -> tuple[float, _Spread, _Spread]:
    """Return the mean of all values, their deviation within subgroups, and that of all."""
    pooled = sample(np.concatenate(arrays) if arrays else (), what, least=2, spread=True)
    within, overall = _pool_within(arrays, subgroup or what), _pool_within([pooled], what)
    mean = subtract_mean(pooled)[0]
    if len(arrays) == 1:
        return mean, within, overall
    means, within_draws, overall_draws = _draw_process(arrays, mean, within)
    return (
        mean,
        replace(within, means=means, deviations=within_draws),
        replace(overall, freedom=None, means=means, deviations=overall_draws),
    )


def _draw_process(arrays: Sequence[Array], mean: float, within: _Spread) -> tuple[Array, Array, Array]:
    """Draw the process mean, and the deviations within subgroups and of all, (D,) each, of several subgroups."""
    assert within.freedom is not None
    random, sizes = np.random.default_rng(20090503), np.array([len(array) for array in arrays])
    group_means = np.array([array.mean() for array in arrays])
    freedom, count = len(arrays) - 1, within.count
    within_draws = within.freedom * within.deviation**2 / random.chisquare(within.freedom, _DRAWS)
    of_means = freedom * float(np.var(group_means, ddof=1)) / random.chisquare(freedom, _DRAWS)
    between_draws = np.maximum(of_means - within_draws * float(np.mean(1 / sizes)), 0.0)
    variance_of_mean = between_draws * float(np.sum(sizes**2)) / count**2 + within_draws / count
    means = mean + random.standard_normal(_DRAWS) * np.sqrt(variance_of_mean)
    return means, np.sqrt(within_draws), np.sqrt(between_draws + within_draws)


def _evaluate_both(spread: _Spread, lower: float | None, upper: float | None, confidence: float) -> Index | None:
    if lower is None or upper is None:
        return None
    narrow, wide = spread.ends((1 - confidence) / 2)
    method = _SUBGROUPS if spread.freedom is None else "chi-square, exact for normal values"
    room = (upper - lower) / 6
    return Index(room / spread.deviation, room / wide, room / narrow, method)


def _nearest(spread: _Spread, mean: float, lower: float | None, upper: float | None, confidence: float) -> Index:
    room = [upper - mean] if upper is not None else []
    room += [mean - lower] if lower is not None else []
    value = min(room) / (3 * spread.deviation)
    if spread.means is not None:
        shift = spread.means - mean
        rooms = [upper - mean - shift] if upper is not None else []
        rooms += [mean - lower + shift] if lower is not None else []
        low, _ = _quantiles(np.minimum.reduce(rooms), spread, confidence)
        # Where both rooms are alike, draws of the lesser one lie below it: the upper end is the lesser of the sides'.
        high = min(_quantiles(one, spread, confidence)[1] for one in rooms)
        return Index(value, low, high, _SUBGROUPS)
    if len(room) == 1:
        low, high = _exact(value, spread, confidence)
        return Index(value, low, high, "noncentral t, exact for normal values")
    assert spread.freedom is not None
    z = float(stats.norm.isf((1 - confidence) / 2))
    half_width = z * sqrt(1 / (9 * spread.count) + value**2 / (2 * spread.freedom))
    return Index(value, value - half_width, value + half_width, "Bissell 1990, for normal values")


def _nearer(low: _Spread, high: _Spread, below: float, above: float, confidence: float) -> Index:
    """Return the lesser of both sides' indices; its interval ends are the lesser of the joint intervals' ends."""
    side_confidence = 1 - (1 - confidence) / 2
    values = [below / (3 * low.deviation), above / (3 * high.deviation)]
    if low.means is not None and high.means is not None:
        # Draws of both means are about their averages; a room shrinks on the side that the mean moves to.
        rooms = below + low.means - low.means.mean(), above - (high.means - high.means.mean())
        ends = [_quantiles(room, spread, side_confidence) for room, spread in zip(rooms, (low, high), strict=True)]
        method = f"{_SUBGROUPS}, both sides, Bonferroni"
    else:
        ends = [_exact(value, spread, side_confidence) for value, spread in zip(values, (low, high), strict=True)]
        method = "noncentral t of both sides, Bonferroni, for normal values"
    low_end, high_end = (min(side) for side in zip(*ends, strict=True))
    return Index(min(values), low_end, high_end, method)


def _room_of_both(low: _Spread, high: _Spread, apart: Sequence[Array], width: float, confidence: float) -> Index:
    """Return Cp of both sides, with an interval from those of both deviations and of ḡ − l̄."""
    tail, pooled = (1 - confidence) / 6, np.concatenate(apart)
    mean_range = float(pooled.mean())
    half_width = float(stats.t.isf(tail, len(pooled) - 1)) * float(pooled.std(ddof=1)) / sqrt(len(pooled))
    if len(apart) > 1:
        squares = sum(float(np.sum((array - array.mean()) ** 2)) for array in apart)
        freedom = len(pooled) - len(apart)
        means, _, _ = _draw_process(apart, mean_range, _Spread(sqrt(squares / freedom), freedom, len(pooled)))
        half_width = float(np.quantile(np.abs(means - mean_range), 1 - 2 * tail))
    room = width - mean_range
    ends = [low.ends(tail), high.ends(tail)]
    narrow_sigma, wide_sigma = (3 * sum(side) for side in zip(*ends, strict=True))
    ratios = [
        end / six_sigma for end in (room - half_width, room + half_width) for six_sigma in (wide_sigma, narrow_sigma)
    ]
    value = room / (3 * (low.deviation + high.deviation))
    return Index(value, min(ratios), max(ratios), "deviations of both sides and mean range, Bonferroni")


def _quantiles(rooms: Array, spread: _Spread, confidence: float) -> tuple[float, float]:
    """Return both ends of the interval of room/3σ from draws of the room and of σ."""
    assert spread.deviations is not None
    tail = (1 - confidence) / 2
    low, high = np.quantile(rooms / (3 * spread.deviations), (tail, 1 - tail))
    return float(low), float(high)


def _exact(value: float, spread: _Spread, confidence: float) -> tuple[float, float]:
    """Return both ends of the interval of an index of one limit."""
    assert spread.freedom is not None
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
