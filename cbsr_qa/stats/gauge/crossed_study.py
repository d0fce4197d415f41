"""Crossed gauge R&R: variance components, by averages and ranges (AIAG MSA, 4th edition 2010, chapter III).

Every sensor (AIAG: part) is measured on every station (appraiser) equally often (trials). Variances add up:

    total = sensor + gauge,   gauge (GRR) = repeatability (EV) + reproducibility (AV)

Averages and ranges are quick, ignore an interaction of sensors and stations, and have no intervals:

    EV = R̄ K₁,  AV² = (X̄_diff K₂)² − EV²/(p r),  PV = R_p K₃;   K₁ = 1/d₂(r),  K₂ = 1/d₂*(o),  K₃ = 1/d₂*(p)

R̄ is the mean range of repeated runs, X̄_diff the range of the stations' means, R_p that of the sensors'.
See also Burdick, Borror & Montgomery 2003.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, prefix_kind
from cbsr_qa.stats.nelson import d2_d3, d2_star
from cbsr_qa.stats.samples import Interval, constant, sample

#: AIAG takes six deviations as the full variation of a process or a gauge.
SIX = 6.0
#: √2 as rounded by AIAG, so that numbers of categories match theirs.
CATEGORY_FACTOR = 1.41


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """A balanced crossed study.

    Parameters
    ----------
    values : (sensors, stations, trials) ndarray, at least two of each.
    sensors, stations : names, sorted.
    appraiser : noun for the stations, for messages.
    """

    values: Array
    sensors: tuple[str, ...]
    stations: tuple[str, ...]
    appraiser: str = "station"

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of sensors, stations and trials."""
        sensors, stations, trials = self.values.shape
        return sensors, stations, trials


@dataclass(frozen=True, slots=True)
class Variance:
    """A component of variance, in the square of the values' unit.

    Parameters
    ----------
    value : variance, at least 0.
    estimate : estimate before it is cut at zero, which may be negative.
    interval : interval whose ends are at least 0; None where the method has none.
    """

    value: float
    estimate: float
    interval: Interval | None = None


@dataclass(frozen=True, slots=True)
class Component:
    """A component of variance and its shares.

    Parameters
    ----------
    variance, deviation : variance in the square of the values' unit, and its root in their unit.
    variance_interval : interval of the variance; None where the method has none.
    percent_contribution, percent_study : percentages of the total variance and of the total deviation.
    percent_tolerance, percent_tolerance_interval : six deviations over the tolerance; None without a tolerance.
    """

    variance: float
    deviation: float
    variance_interval: Interval | None
    percent_contribution: float
    percent_study: float
    percent_tolerance: float | None
    percent_tolerance_interval: Interval | None


@dataclass(frozen=True, slots=True)
class Components:
    """Variance components of a study, by source of variation."""

    repeatability: Component
    reproducibility: Component
    gauge: Component
    sensor: Component
    total: Component


@dataclass(frozen=True, slots=True)
class Variation:
    """Variance components of a study, and indices derived from them.

    Parameters
    ----------
    categories : number of distinct categories, 1.41 × sensor / gauge deviation, cut to a whole number of at least 1;
        None where the gauge does not vary.
    categories_uncut : the number before it is cut.
    notes : adjustments made, in sentences.
    """

    components: Components
    categories: int | None
    categories_uncut: float | None
    notes: tuple[str, ...]


def variation(
    repeatability: Variance,
    reproducibility: Variance,
    gauge: Variance,
    sensor: Variance,
    total: Variance,
    *,
    tolerance: float | None,
    notes: tuple[str, ...],
) -> Variation:
    """Return the shares of components.

    Parameters
    ----------
    tolerance : width of the metric's limits, in its unit; None unless it has both.
    notes : adjustments made, in sentences.
    """

    def share_of(part: Variance) -> Component:
        deviation = sqrt(part.value)
        percent_tolerance = interval = None
        if tolerance is not None:
            percent_tolerance = 100 * SIX * deviation / tolerance
            if part.interval is not None:
                low, high = (100 * SIX * sqrt(end) / tolerance for end in (part.interval.low, part.interval.high))
                interval = Interval(low, high, part.interval.confidence)
        contribution, study_share = 100 * part.value / total.value, 100 * deviation / sqrt(total.value)
        return Component(part.value, deviation, part.interval, contribution, study_share, percent_tolerance, interval)

    variances = (repeatability, reproducibility, gauge, sensor, total)
    uncut = CATEGORY_FACTOR * sqrt(sensor.value / gauge.value) if gauge.value else None
    categories = None if uncut is None else max(int(uncut), 1)
    return Variation(Components(*map(share_of, variances)), categories, uncut, notes)


def study(
    sensors: Sequence[str], stations: Sequence[str], values: Sequence[float], *, appraiser: str = "station"
) -> Study:
    """Arrange runs as a crossed study.

    Parameters
    ----------
    sensors, stations : (N,) names of each run.
    values : (N,) the metric of each run; the trials of a sensor on a station keep their order.
    appraiser : noun for the stations: "station", or "operator" where people are compared.

    Raises
    ------
    NumericsError
        If values are missing, a sensor was not measured on every station equally often, there are fewer than two
        sensors, stations or trials, or repeated runs do not differ at all.
    """
    array = sample(values, "gauge study", least=8)
    if not len(sensors) == len(stations) == len(array):
        raise NumericsError(f"gauge study: {len(sensors)} sensors, {len(stations)} {appraiser}s, {len(array)} values")
    rows, columns = sorted(set(sensors)), sorted(set(stations))
    cells: dict[tuple[str, str], list[float]] = {(row, column): [] for row in rows for column in columns}
    for sensor, station, value in zip(sensors, stations, array, strict=True):
        cells[sensor, station].append(float(value))
    _check_balance(cells, rows, columns, appraiser)
    table = np.array([[cells[row, column] for column in columns] for row in rows])
    return Study(table, tuple(rows), tuple(columns), appraiser)


def count_usual_trials(counts: Iterable[int]) -> int:
    """Return the most common number of runs per cell (of equally common numbers the larger).

    Empty cells do not count, however many they are.
    """
    cells_by_count = Counter(count for count in counts if count)
    return max(cells_by_count, key=lambda count: (cells_by_count[count], count), default=0)


def on(appraiser: str) -> str:
    """Return the preposition of the appraiser: on a station, by an operator."""
    return "on" if appraiser == "station" else "by"


def _check_balance(
    cells: dict[tuple[str, str], list[float]], rows: list[str], columns: list[str], appraiser: str
) -> None:
    trials = count_usual_trials(map(len, cells.values()))
    for (sensor, station), values in cells.items():
        if len(values) != trials:
            raise NumericsError(
                f"gauge study: sensor {sensor} has {len(values)} run{'s' * (len(values) != 1)} {on(appraiser)} "
                f"{prefix_kind(appraiser, station)}, others have {trials}",
                remedy=f"a crossed study has every sensor equally often {on(appraiser)} every {appraiser}: add the "
                "missing runs, or leave that sensor out",
            )
    sizes = (("sensor", "", len(rows)), (appraiser, "", len(columns)), ("run", f" a sensor and {appraiser}", trials))
    for noun, qualifier, count in sizes:
        if count < 2:
            raise NumericsError(f"gauge study: {count} {noun}{'s' * (count != 1)}{qualifier} instead of at least 2")
    if all(constant(np.array(values)) for values in cells.values()):
        raise NumericsError(
            "gauge study: repeated runs do not differ at all, so repeatability cannot be estimated",
            remedy="record more digits",
        )


def clip_at_zero(estimate: float, interval: Interval | None = None) -> Variance:
    """Return a component with its estimate and interval cut at zero."""
    if interval is not None:
        interval = Interval(max(interval.low, 0.0), max(interval.high, 0.0), interval.confidence)
    return Variance(max(estimate, 0.0), estimate, interval)


def check_tolerance(tolerance: float | None) -> None:
    """Refuse a tolerance that is not a positive width."""
    if tolerance is not None and not tolerance > 0:
        raise NumericsError(f"gauge study: tolerance is {tolerance:g}; allowed are positive widths")


@dataclass(frozen=True, slots=True)
class GaugeRange(Variation):
    """A study by averages and ranges.

    Parameters
    ----------
    mean_range, appraiser_range, sensor_range : R̄, X̄_diff and R_p, in the values' unit.
    """

    mean_range: float
    appraiser_range: float
    sensor_range: float


def gauge_range(study: Study, *, tolerance: float | None = None) -> GaugeRange:
    """Return the components of a crossed study.

    ``tolerance``: width of the metric's limits, in its unit; NumericsError if it is not positive.
    """
    check_tolerance(tolerance)
    p, o, r = study.shape
    mean_range = float(np.ptp(study.values, axis=2).mean())
    appraiser_range = float(np.ptp(study.values.mean(axis=(0, 2))))
    sensor_range = float(np.ptp(study.values.mean(axis=(1, 2))))
    repeatability = (mean_range / d2_d3(r)[0]) ** 2
    reproducibility = clip_at_zero((appraiser_range / d2_star(o, 1)) ** 2 - repeatability / (p * r))
    sensor = (sensor_range / d2_star(p, 1)) ** 2
    gauge = repeatability + reproducibility.value
    note = f"{study.appraiser}s differ no more than repeated runs do: reproducibility was set to zero"
    variances = (
        clip_at_zero(repeatability),
        reproducibility,
        clip_at_zero(gauge),
        clip_at_zero(sensor),
        clip_at_zero(gauge + sensor),
    )
    result = variation(*variances, tolerance=tolerance, notes=(note,) if reproducibility.estimate < 0 else ())
    return GaugeRange(
        result.components,
        result.categories,
        result.categories_uncut,
        result.notes,
        mean_range,
        appraiser_range,
        sensor_range,
    )
