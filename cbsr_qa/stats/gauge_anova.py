"""Crossed gauge R&R by analysis of variance, all effects random (AIAG MSA 4th edition, chapter III and appendix A).

With p sensors, o stations and r trials the expected mean squares are

    MS_sensor = σ² + r σ²_so + o r σ²_s,    MS_station = σ² + r σ²_so + p r σ²_o,
    MS_inter = σ² + r σ²_so,                MS_trial = σ²

The interaction is pooled with the trials where its p value is above 0.25. Intervals of variances are modified
large-sample ones, those of shares and categories come from pivots (:mod:`cbsr_qa.stats.large_sample`).
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy import stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.gauge_study import CATEGORY_FACTOR, Study, Variance, Variation, check_tolerance, clipped
from cbsr_qa.stats.large_sample import MeanSquare, pivot_interval, sum_interval
from cbsr_qa.stats.samples import Interval, share

#: AIAG's level: an interaction that is less significant is taken for repeatability.
POOLING_LEVEL = 0.25


class Source(StrEnum):
    """Rows of the table."""

    STATION = "station"
    SENSOR = "sensor"
    INTERACTION = "sensor × station"
    TRIAL = "repeated runs"


@dataclass(frozen=True, slots=True)
class Row:
    """One source: sum of squares, degrees of freedom, mean square, F and its p value (None for the trials)."""

    source: Source
    squares: float
    freedom: int
    mean_square: float
    statistic: float | None
    p_value: float | None


@dataclass(frozen=True, slots=True)
class GaugeAnova:
    """A study by analysis of variance.

    Parameters
    ----------
    table : before pooling, F of sensor and station against the interaction.
    pooled : whether the interaction went into repeatability.
    variation : components with intervals.
    station, interaction : the two parts of reproducibility; interaction None where pooled.
    gauge_share, categories : intervals of the gauge's share of the total variance (0 to 1) and of the uncut number of
        categories.
    """

    table: tuple[Row, ...]
    pooled: bool
    variation: Variation
    station: Variance
    interaction: Variance | None
    gauge_share: Interval
    categories: Interval


@dataclass(frozen=True, slots=True)
class _Squares:
    """Mean squares that components are made of; ``inner`` is the interaction, or the pooled trials."""

    sensor: MeanSquare
    station: MeanSquare
    inner: MeanSquare
    trial: MeanSquare
    shape: tuple[int, int, int]
    pooled: bool

    def parts(self, *factors: float) -> list[MeanSquare]:
        """Sensor, station, inner and trial times their factors; pooled, the last two are one source."""
        sources = [self.sensor, self.station, self.inner, self.trial]
        if self.pooled:
            sources, factors = sources[:3], (*factors[:2], factors[2] + factors[3])
        pairs = zip(sources, factors, strict=True)
        return [MeanSquare(source.value, source.freedom, factor) for source, factor in pairs if factor]


def gauge_anova(study: Study, *, tolerance: float | None = None, confidence: float = 0.95) -> GaugeAnova:
    """Return components, shares and intervals of a crossed study.

    Parameters
    ----------
    tolerance : width of the metric's limits, in its unit.

    Raises
    ------
    NumericsError
        A tolerance or confidence that is none.
    """
    check_tolerance(tolerance)
    share(confidence, "confidence")
    table = _table(study)
    rows = {row.source: row for row in table}
    pooled = (rows[Source.INTERACTION].p_value or 0.0) > POOLING_LEVEL
    squares = _squares(rows, study.shape, pooled)
    p, _, r = study.shape
    gauge = _component(squares, (0, 1 / (p * r), (p - 1) / (p * r), (r - 1) / r), confidence)
    station = _component(squares, (0, 1 / (p * r), -1 / (p * r), 0), confidence)
    interaction = None if pooled else _component(squares, (0, 0, 1 / r, -1 / r), confidence)
    sources, ratio = squares.parts(1, 1, 1, 1), _GaugeShare(study.shape, pooled)
    return GaugeAnova(
        table=table,
        pooled=pooled,
        variation=_variation(squares, gauge, station, interaction, tolerance, confidence, study.appraiser),
        station=station,
        interaction=interaction,
        gauge_share=pivot_interval(sources, ratio, confidence),
        categories=pivot_interval(sources, ratio.categories, confidence),
    )


def _table(study: Study) -> tuple[Row, ...]:
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
    return tuple(_row(source, *squares[source], below) for source, below in against.items())


def _row(source: Source, squares: float, freedom: int, below: tuple[float, int] | None) -> Row:
    mean_square = squares / freedom
    if below is None or below[0] == 0:
        return Row(source, squares, freedom, mean_square, None, None)
    statistic = mean_square / (below[0] / below[1])
    return Row(source, squares, freedom, mean_square, statistic, float(stats.f.sf(statistic, freedom, below[1])))


def _squares(rows: dict[Source, Row], shape: tuple[int, int, int], pooled: bool) -> _Squares:
    sensor, station, inner, trial = (
        MeanSquare(rows[source].mean_square, rows[source].freedom)
        for source in (Source.SENSOR, Source.STATION, Source.INTERACTION, Source.TRIAL)
    )
    if pooled:
        freedom = inner.freedom + trial.freedom
        squares = inner.value * inner.freedom + trial.value * trial.freedom
        inner = trial = MeanSquare(squares / freedom, freedom)
    return _Squares(sensor, station, inner, trial, shape, pooled)


def _component(squares: _Squares, factors: tuple[float, float, float, float], confidence: float) -> Variance:
    """Σ factor × mean square of sensor, station, interaction and trials, with its interval."""
    parts = squares.parts(*factors)
    return clipped(sum(part.factor * part.value for part in parts), sum_interval(parts, confidence))


def _variation(
    squares: _Squares,
    gauge: Variance,
    station: Variance,
    interaction: Variance | None,
    tolerance: float | None,
    confidence: float,
    appraiser: str,
) -> Variation:
    """Add the components up as AIAG does: each is cut at zero first, and totals are sums of what is left."""
    p, o, r = squares.shape
    repeatability = _component(squares, (0, 0, 0, 1), confidence)
    apart = _component(squares, (0, 1 / (p * r), (p - 1) / (p * r), -1 / r), confidence)
    sensor = _component(squares, (1 / (o * r), 0, -1 / (o * r), 0), confidence)
    between = station.value + (interaction.value if interaction else 0.0)
    whole = _component(squares, _total_factors(squares.shape), confidence)
    both = repeatability.value + between
    named = {appraiser: station, "sensor": sensor} | ({"interaction": interaction} if interaction else {})
    notes = tuple(
        f"the estimate of the {name} variance is {part.estimate:.3g} and was set to zero"
        for name, part in named.items()
        if part.estimate < 0
    )
    return Variation(
        repeatability=repeatability,
        reproducibility=Variance(between, apart.estimate, apart.interval),
        gauge=Variance(both, gauge.estimate, gauge.interval),
        sensor=sensor,
        total=Variance(both + sensor.value, whole.estimate, whole.interval),
        tolerance=tolerance,
        notes=notes,
    )


def _total_factors(shape: tuple[int, int, int]) -> tuple[float, float, float, float]:
    """Total = [p MS_s + o MS_o + (po − p − o) MS_so + po(r − 1) MS_t] / (por)."""
    p, o, r = shape
    return 1 / (o * r), 1 / (p * r), (p * o - p - o) / (p * o * r), (r - 1) / r


@dataclass(frozen=True, slots=True)
class _GaugeShare:
    """The gauge's share of the total variance as a function of mean squares, (3 or 4, draws) → (draws,)."""

    shape: tuple[int, int, int]
    pooled: bool

    def __call__(self, drawn: Array) -> Array:
        p, o, r = self.shape
        sensor, station, inner = drawn[:3]
        trial = inner if self.pooled else drawn[3]
        gauge = np.maximum(station - inner, 0) / (p * r) + np.maximum(inner - trial, 0) / r + trial
        spread = np.maximum(sensor - inner, 0) / (o * r)
        ratio: Array = gauge / (gauge + spread)
        return ratio

    def categories(self, drawn: Array) -> Array:
        """1.41 × √(sensor / gauge variance)."""
        count: Array = CATEGORY_FACTOR * np.sqrt(1 / self(drawn) - 1)
        return count
