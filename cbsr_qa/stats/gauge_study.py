"""A crossed gauge study and what comes of it, whichever way it is worked out.

Every sensor (AIAG: part) is measured on every station (appraiser) equally often (trials). Variances add up:

    total = sensor + gauge,   gauge (GRR) = repeatability (EV) + reproducibility (AV)

Sources: AIAG, Measurement Systems Analysis, 4th edition 2010, chapter III; Burdick, Borror & Montgomery 2003.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.naming import of_kind
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.samples import Interval, constant, sample

#: AIAG counts six deviations for all of a process's or a gauge's variation.
SIX = 6.0
#: √2 as AIAG rounds it, so that numbers of categories are theirs.
CATEGORY_FACTOR = 1.41


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """A balanced crossed study.

    Parameters
    ----------
    values : (sensors, stations, trials) ndarray, at least two of each.
    sensors, stations : names, sorted.
    appraiser : what the stations are, for messages.
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
    value : at least 0.
    estimate : as it came out, which may be negative.
    interval : at least 0; None where the method has none.
    """

    value: float
    estimate: float
    interval: Interval | None = None

    @property
    def deviation(self) -> float:
        """Return its root, in the values' unit."""
        return sqrt(self.value)


@dataclass(frozen=True, slots=True)
class Variation:
    """Where the variation of a study comes from.

    Parameters
    ----------
    repeatability, reproducibility, gauge, sensor, total : components.
    tolerance : width of the metric's limits, in its unit; None where it has one limit or none.
    notes : what was done to the numbers, in sentences.
    """

    repeatability: Variance
    reproducibility: Variance
    gauge: Variance
    sensor: Variance
    total: Variance
    tolerance: float | None
    notes: tuple[str, ...] = ()

    @property
    def categories(self) -> int:
        """Number of distinct categories, 1.41 × sensor / gauge deviation cut to a whole number; at least 1."""
        return max(int(self.categories_uncut), 1)

    @property
    def categories_uncut(self) -> float:
        """1.41 × sensor / gauge deviation."""
        return CATEGORY_FACTOR * self.sensor.deviation / self.gauge.deviation

    def percent_contribution(self, part: Variance) -> float:
        """Return a component's share of the total variance."""
        return 100 * part.value / self.total.value

    def percent_study(self, part: Variance) -> float:
        """Return a component's deviation over the total one."""
        return 100 * part.deviation / self.total.deviation

    def percent_tolerance(self, part: Variance) -> float | None:
        """Return six deviations of a component over the tolerance; None without one."""
        return None if self.tolerance is None else 100 * SIX * part.deviation / self.tolerance

    def tolerance_interval(self, part: Variance) -> Interval | None:
        """Return the interval of :meth:`percent_tolerance`; None without a tolerance or an interval."""
        if self.tolerance is None or part.interval is None:
            return None
        low, high = (100 * SIX * sqrt(end) / self.tolerance for end in (part.interval.low, part.interval.high))
        return Interval(low, high, part.interval.confidence)


def study(
    sensors: Sequence[str], stations: Sequence[str], values: Sequence[float], *, appraiser: str = "station"
) -> Study:
    """Arrange runs as a crossed study.

    Parameters
    ----------
    sensors, stations : (N,) names of each run.
    values : (N,); trials of one sensor on one station in their order.
    appraiser : what the stations are: "station", or "operator" where people are compared.

    Raises
    ------
    NumericsError
        Missing values, a sensor that is not on every station equally often, or fewer than two of anything.
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


def usual_trials(counts: Iterable[int]) -> int:
    """Return how many runs most cells have (of equally common counts the larger): others have too few or too many.

    Cells without runs do not count: none is what they have too few of, however many they are.
    """
    found = Counter(count for count in counts if count)
    return max(found, key=lambda count: (found[count], count), default=0)


def on(appraiser: str) -> str:
    """Return the word between what was measured and who did: on a station, by an operator."""
    return "on" if appraiser == "station" else "by"


def _check_balance(
    cells: dict[tuple[str, str], list[float]], rows: list[str], columns: list[str], appraiser: str
) -> None:
    trials = usual_trials(map(len, cells.values()))
    for (sensor, station), found in cells.items():
        if len(found) != trials:
            raise NumericsError(
                f"gauge study: sensor {sensor} has {len(found)} run{'s' * (len(found) != 1)} {on(appraiser)} "
                f"{of_kind(appraiser, station)}, others have {trials}",
                remedy=f"a crossed study has every sensor {on(appraiser)} every {appraiser} equally often: add the "
                "missing runs, or leave that sensor out",
            )
    sizes = (("sensor", "", len(rows)), (appraiser, "", len(columns)), ("run", f" a sensor and {appraiser}", trials))
    for one, of, count in sizes:
        if count < 2:
            raise NumericsError(f"gauge study: {count} {one}{'s' * (count != 1)}{of} instead of at least 2")
    if all(constant(np.array(found)) for found in cells.values()):
        raise NumericsError(
            "gauge study: repeated runs do not differ at all, which leaves no repeatability to estimate",
            remedy="record more digits",
        )


def clipped(estimate: float, interval: Interval | None = None) -> Variance:
    """Return a component whose estimate, and the interval with it, is cut at zero."""
    if interval is not None:
        interval = Interval(max(interval.low, 0.0), max(interval.high, 0.0), interval.confidence)
    return Variance(max(estimate, 0.0), estimate, interval)


def check_tolerance(tolerance: float | None) -> None:
    """Refuse a tolerance that is no width.

    Raises
    ------
    NumericsError
        It is not positive.
    """
    if tolerance is not None and not tolerance > 0:
        raise NumericsError(f"gauge study: a tolerance of {tolerance:g} is none; allowed are positive widths")
