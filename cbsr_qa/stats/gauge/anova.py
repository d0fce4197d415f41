"""Crossed gauge R&R by analysis of variance, all effects random (AIAG MSA 4th edition, chapter III and appendix A).

With p sensors, o stations and r trials the expected mean squares are

    MS_sensor = σ² + r σ²_so + o r σ²_s,    MS_station = σ² + r σ²_so + p r σ²_o,
    MS_inter = σ² + r σ²_so,                MS_trial = σ²

The interaction is pooled with the trials where its p value is above 0.25; F of sensor and station is then against the
pooled mean square (SS_inter + SS_trial)/(ν_inter + ν_trial).

Intervals of γ = Σ c_q θ_q are modified large-sample ones, exact whenever all but one θ vanish (Graybill & Wang 1980
for sums; Ting, Burdick, Graybill, Jeyaratnam & Lu 1990 with differences; Burdick & Graybill 1992, section 3.3).
Ratios take the generalised pivotal quantities n S²/χ²_n (Hamada & Weerahandi 2000).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import sqrt

import numpy as np
from scipy import stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.gauge.crossed_study import (
    CATEGORY_FACTOR,
    Study,
    Variance,
    Variation,
    check_tolerance,
    clip_at_zero,
    variation,
)
from cbsr_qa.stats.samples import Interval, share

_DRAWS = 20_000


@dataclass(frozen=True, slots=True)
class MeanSquare:
    """S² with n degrees of freedom, counted ``factor`` times; negative ones are subtracted."""

    value: float
    freedom: int
    factor: float = 1.0

    @property
    def term(self) -> float:
        """Return |c| S²."""
        return abs(self.factor) * self.value


@dataclass(frozen=True, slots=True)
class _Tails:
    """Coefficients G, H and their mixed kinds at one tail probability."""

    tail: float

    def g(self, n: int) -> float:
        return 1 - n / float(stats.chi2.isf(self.tail, n))

    def h(self, n: int) -> float:
        return n / float(stats.chi2.ppf(self.tail, n)) - 1

    def g_mixed(self, plus: int, minus: int) -> float:
        f = float(stats.f.isf(self.tail, plus, minus))
        return ((f - 1) ** 2 - self.g(plus) ** 2 * f**2 - self.h(minus) ** 2) / f

    def h_mixed(self, plus: int, minus: int) -> float:
        f = float(stats.f.ppf(self.tail, plus, minus))
        return ((1 - f) ** 2 - self.h(plus) ** 2 * f**2 - self.g(minus) ** 2) / f

    def alike(self, one: int, two: int) -> float:
        sum_term = self.g(one + two) ** 2 * (one + two) ** 2 / (one * two)
        return sum_term - self.g(one) ** 2 * one / two - self.g(two) ** 2 * two / one


def sum_interval(parts: Sequence[MeanSquare], confidence: float) -> Interval:
    """Return the interval of Σ c_q θ_q, where at least one factor is positive."""
    tails = _Tails((1 - confidence) / 2)
    plus = [part for part in parts if part.factor > 0]
    minus = [part for part in parts if part.factor < 0]
    value = sum(part.factor * part.value for part in parts)
    below_squared = sum((tails.g(p.freedom) * p.term) ** 2 for p in plus)
    below_squared += sum((tails.h(m.freedom) * m.term) ** 2 for m in minus)
    above_squared = sum((tails.h(p.freedom) * p.term) ** 2 for p in plus)
    above_squared += sum((tails.g(m.freedom) * m.term) ** 2 for m in minus)
    below_squared += sum(tails.g_mixed(p.freedom, m.freedom) * p.term * m.term for p in plus for m in minus)
    above_squared += sum(tails.h_mixed(p.freedom, m.freedom) * p.term * m.term for p in plus for m in minus)
    if plus and minus:
        below_squared += _pairs(plus, tails)
        above_squared += _pairs(minus, tails)
    return Interval(value - sqrt(max(below_squared, 0.0)), value + sqrt(max(above_squared, 0.0)), confidence)


def _pairs(parts: Sequence[MeanSquare], tails: _Tails) -> float:
    """Cross terms of mean squares of one sign."""
    total = 0.0
    for index, part in enumerate(parts):
        for two in parts[index + 1 :]:
            total += tails.alike(part.freedom, two.freedom) * part.term * two.term
    return total / (len(parts) - 1) if len(parts) > 1 else 0.0


def pivot_interval(squares: Sequence[MeanSquare], function: Callable[[Array], Array], confidence: float) -> Interval:
    """Return the interval of a function (k, draws) → (draws,) of the true mean squares; draws have a fixed seed."""
    random = np.random.default_rng(20000415)
    drawn_variances = np.array(
        [square.freedom * square.value / random.chisquare(square.freedom, _DRAWS) for square in squares]
    )
    tail = (1 - confidence) / 2
    low, high = np.quantile(function(drawn_variances), [tail, 1 - tail])
    return Interval(float(low), float(high), confidence)


#: AIAG's level: a less significant interaction is pooled with repeatability.
POOLING_LEVEL = 0.25


class Source(StrEnum):
    """Rows of the table."""

    STATION = "station"
    SENSOR = "sensor"
    INTERACTION = "sensor × station"
    TRIAL = "repeated runs"
    POOLED = "pooled: interaction and repeated runs"


@dataclass(frozen=True, slots=True)
class Row:
    """One source of variation; F and its p value are None for repeated runs and what is pooled with them."""

    source: str
    sum_of_squares: float
    degrees_of_freedom: int
    mean_square: float
    f: float | None
    p: float | None


@dataclass(frozen=True, slots=True)
class GaugeAnova(Variation):
    """A study by analysis of variance.

    Parameters
    ----------
    table : F of sensor and appraiser is against the interaction, or where that is pooled against the pooled mean
        square, which is the last row.
    interaction_pooled : whether the interaction is part of repeatability.
    appraiser_variance, interaction_variance : the two parts of reproducibility; the second is None where pooled, and
        in a nested study.
    gauge_percent_contribution_interval : interval of the gauge's share of the total variance [%].
    categories_interval : interval of the uncut number of categories.
    """

    table: tuple[Row, ...]
    interaction_pooled: bool
    appraiser_variance: float
    interaction_variance: float | None
    gauge_percent_contribution_interval: Interval
    categories_interval: Interval


@dataclass(frozen=True, slots=True)
class _Squares:
    """Mean squares behind the components; ``inner`` is the interaction, or the pooled trials."""

    sensor: MeanSquare
    station: MeanSquare
    inner: MeanSquare
    trial: MeanSquare
    shape: tuple[int, int, int]
    pooled: bool

    def parts(self, *factors: float) -> list[MeanSquare]:
        sources = [self.sensor, self.station, self.inner, self.trial]
        if self.pooled:
            sources, factors = sources[:3], (*factors[:2], factors[2] + factors[3])
        pairs = zip(sources, factors, strict=True)
        return [MeanSquare(source.value, source.freedom, factor) for source, factor in pairs if factor]


def gauge_anova(study: Study, *, tolerance: float | None = None, confidence: float = 0.95) -> GaugeAnova:
    """Return components, shares and intervals of a crossed study.

    ``tolerance``: width of the metric's limits, in its unit.

    Raises
    ------
    NumericsError
        The tolerance is not positive, or the confidence not between 0 and 1.
    """
    check_tolerance(tolerance)
    share(confidence, "confidence")
    rows = _table(study)
    pooled = (rows[Source.INTERACTION].p or 0.0) > POOLING_LEVEL
    squares = _squares(rows, study.shape, pooled)
    p, _, r = study.shape
    gauge = _component(squares, (0, 1 / (p * r), (p - 1) / (p * r), (r - 1) / r), confidence)
    station = _component(squares, (0, 1 / (p * r), -1 / (p * r), 0), confidence)
    interaction = None if pooled else _component(squares, (0, 0, 1 / r, -1 / r), confidence)
    sources = squares.parts(1, 1, 1, 1)

    def gauge_share(drawn: Array) -> Array:
        return _gauge_share(study.shape, drawn)

    def categories(drawn: Array) -> Array:
        return CATEGORY_FACTOR * np.sqrt(1 / gauge_share(drawn) - 1)

    shares = _variation(squares, gauge, station, interaction, tolerance, confidence, study.appraiser)
    return GaugeAnova(
        components=shares.components,
        categories=shares.categories,
        categories_uncut=shares.categories_uncut,
        notes=shares.notes,
        table=_pool_table(rows) if pooled else tuple(rows.values()),
        interaction_pooled=pooled,
        appraiser_variance=station.value,
        interaction_variance=None if interaction is None else interaction.value,
        gauge_percent_contribution_interval=pivot_interval(sources, gauge_share, confidence).scale(100.0),
        categories_interval=pivot_interval(sources, categories, confidence),
    )


def _table(study: Study) -> dict[Source, Row]:
    values = study.values - study.values.mean()
    p, o, r = study.shape
    sensors, stations, cells = values.mean(axis=(1, 2)), values.mean(axis=(0, 2)), values.mean(axis=2)
    mixed = cells - sensors[:, None] - stations + values.mean()
    squares = {
        Source.STATION: (p * r * float(np.sum(stations**2)), o - 1),
        Source.SENSOR: (o * r * float(np.sum(sensors**2)), p - 1),
        Source.INTERACTION: (r * float(np.sum(mixed**2)), (p - 1) * (o - 1)),
        Source.TRIAL: (float(np.sum((values - cells[:, :, None]) ** 2)), p * o * (r - 1)),
    }
    inner, trial = (squares[source] for source in (Source.INTERACTION, Source.TRIAL))
    against = {Source.STATION: inner, Source.SENSOR: inner, Source.INTERACTION: trial, Source.TRIAL: None}
    names = {source: str(source).replace(str(Source.STATION), study.appraiser) for source in Source}
    return {source: make_row(names[source], *squares[source], below) for source, below in against.items()}


def _pool_table(rows: dict[Source, Row]) -> tuple[Row, ...]:
    """Return the table with F of sensor and appraiser against the interaction and the trials together."""
    inner, trial = rows[Source.INTERACTION], rows[Source.TRIAL]
    squares = inner.sum_of_squares + trial.sum_of_squares
    freedom = inner.degrees_of_freedom + trial.degrees_of_freedom
    station, sensor = (
        make_row(row.source, row.sum_of_squares, row.degrees_of_freedom, (squares, freedom))
        for row in (rows[Source.STATION], rows[Source.SENSOR])
    )
    return station, sensor, inner, trial, make_row(Source.POOLED, squares, freedom, None)


def make_row(source: str, squares: float, freedom: int, below: tuple[float, int] | None) -> Row:
    """Return a row of the table; ``below`` are sum of squares and freedom that F is against, None without F."""
    mean_square = squares / freedom
    if below is None or below[0] == 0:
        return Row(source, squares, freedom, mean_square, None, None)
    statistic = mean_square / (below[0] / below[1])
    return Row(source, squares, freedom, mean_square, statistic, float(stats.f.sf(statistic, freedom, below[1])))


def _squares(rows: dict[Source, Row], shape: tuple[int, int, int], pooled: bool) -> _Squares:
    sensor, station, inner, trial = (
        MeanSquare(rows[source].mean_square, rows[source].degrees_of_freedom)
        for source in (Source.SENSOR, Source.STATION, Source.INTERACTION, Source.TRIAL)
    )
    if pooled:
        freedom = inner.freedom + trial.freedom
        squares = inner.value * inner.freedom + trial.value * trial.freedom
        inner = trial = MeanSquare(squares / freedom, freedom)
    return _Squares(sensor, station, inner, trial, shape, pooled)


def _component(squares: _Squares, factors: tuple[float, float, float, float], confidence: float) -> Variance:
    """Σ factor × mean square of sensor, station, interaction and trials, with its interval."""
    terms = squares.parts(*factors)
    return clip_at_zero(sum(part.factor * part.value for part in terms), sum_interval(terms, confidence))


def _variation(
    squares: _Squares,
    gauge: Variance,
    station: Variance,
    interaction: Variance | None,
    tolerance: float | None,
    confidence: float,
    appraiser: str,
) -> Variation:
    """Sum the components as AIAG does: each is cut at zero first, then summed to totals."""
    p, o, r = squares.shape
    repeatability = _component(squares, (0, 0, 0, 1), confidence)
    reproducibility = _component(squares, (0, 1 / (p * r), (p - 1) / (p * r), -1 / r), confidence)
    sensor = _component(squares, (1 / (o * r), 0, -1 / (o * r), 0), confidence)
    reproducibility_value = station.value + (interaction.value if interaction else 0.0)
    # Total = [p MS_s + o MS_o + (po − p − o) MS_so + po(r − 1) MS_t] / (por).
    total_factors = (1 / (o * r), 1 / (p * r), (p * o - p - o) / (p * o * r), (r - 1) / r)
    total_variance = _component(squares, total_factors, confidence)
    gauge_value = repeatability.value + reproducibility_value
    variance_by_name = {appraiser: station, "sensor": sensor} | ({"interaction": interaction} if interaction else {})
    notes = tuple(
        f"the estimated {name} variance is negative and is set to zero"
        for name, variance in variance_by_name.items()
        if variance.estimate < 0
    )
    return variation(
        repeatability,
        Variance(reproducibility_value, reproducibility.estimate, reproducibility.interval),
        Variance(gauge_value, gauge.estimate, gauge.interval),
        sensor,
        Variance(gauge_value + sensor.value, total_variance.estimate, total_variance.interval),
        tolerance=tolerance,
        notes=notes,
    )


def _gauge_share(shape: tuple[int, int, int], drawn: Array) -> Array:
    """Return the gauge's share of the total variance, (draws,), of mean squares (4, or 3 where pooled, draws)."""
    p, o, r = shape
    sensor, station, inner = drawn[:3]
    trial = drawn[-1]
    gauge = np.maximum(station - inner, 0) / (p * r) + np.maximum(inner - trial, 0) / r + trial
    spread = np.maximum(sensor - inner, 0) / (o * r)
    ratio: Array = gauge / (gauge + spread)
    return ratio
