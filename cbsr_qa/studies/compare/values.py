"""One value per run and metric: the mean over loads for metrics with a value per load.

The limits of a recipe judge every load, so the least and the greatest value are kept too.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.fleet import FleetTable, MetricKey, State
from cbsr_qa.domain.results.measurement import metric_words
from cbsr_qa.report.tables import list_names, plural
from cbsr_qa.stats.samples import LARGEST

BoolArray = NDArray[np.bool_]

# Cautions about one metric.
_OTHER_UNIT: Final = "measured in {other} instead of {unit}, left out: {sensors}"
_NEVER_MEASURED: Final = "without this measurement, left out: {sensors}"
_OTHER_RECIPE: Final = "{runs} of recipes that do not measure it, left out: {recipes}"
_BEYOND: Final = f"infinite or beyond {LARGEST:g}, left out: {{values}}"
_NOT_MEASURED: Final = "could not be measured, left out: {sensors}"
_LOWER_BOUND: Final = "only a lower bound is known, left out: {sensors}"
_FEWER: Final = "fewer than {most} values, the mean is of the rest: {sensors}"
_SEVERAL_LIMITS: Final = "runs had different limits; capability uses those of the latest run"


@dataclass(frozen=True, slots=True)
class OfMetric:
    """Identity of a metric, and the unit of its values."""

    name: str
    phase: str
    qualifier: str
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class MetricValues:
    """A metric of every run.

    Parameters
    ----------
    title : name of the metric, with phase and qualifier if another metric has the same name.
    lower, upper : limit of the latest run with one, or None.
    mean, least, most : (R,) mean, smallest and largest of each run's values; NaN without any, or if one is only a
        lower bound, infinite or too large to be squared.
    per_run : largest number of values per run.
    at : location → (R,) mean of the values there; empty for values without location.
    failed : (R,) whether a value was outside its limit or, though limited, could not be measured.
    """

    key: MetricKey
    title: str
    unit: str
    lower: float | None
    upper: float | None
    mean: Array
    least: Array
    most: Array
    per_run: int
    at: Mapping[str, Array]
    failed: BoolArray
    warnings: tuple[str, ...]

    @property
    def identity(self) -> tuple[str, str, str, str]:
        return self.key.name, self.key.phase, self.key.qualifier, self.unit

    @property
    def limited(self) -> bool:
        return self.lower is not None or self.upper is not None


def values_of(table: FleetTable, used: BoolArray) -> Iterator[MetricValues]:
    """Yield the values of each metric in the runs that count (R,), in the order of measurement."""
    keys = list(dict.fromkeys(kind.key for kind in table.kinds))
    if not keys:  # no run has a measurement
        return
    places = {key: place for place, key in enumerate(keys)}
    of_kind = np.array([places[kind.key] for kind in table.kinds], dtype=np.intp)
    rows = np.flatnonzero(used[table.run]) if len(table.run) else np.zeros(0, dtype=np.intp)
    metric = of_kind[table.kind[rows]]
    order = rows[np.argsort(metric, kind="stable")]
    ends = np.cumsum(np.bincount(metric, minlength=len(keys)))
    named_so = Counter(key.name for key in keys)
    for key, chosen in zip(keys, np.split(order, ends[:-1]), strict=True):
        if len(chosen):
            title = metric_words(key.name) if named_so[key.name] == 1 else key.title
            yield _values(key, title, table, chosen, used)


def _values(key: MetricKey, title: str, table: FleetTable, rows: NDArray[np.intp], used: BoolArray) -> MetricValues:
    absent_warnings = _absent(table, rows, used)
    rows, unit_warnings = _keep_one_unit(table, rows)
    run, value, state = table.run[rows], table.value[rows], table.state[rows]
    kinds = [table.kinds[index] for index in np.unique(table.kind[rows])]
    runs = len(table.runs)
    is_bounded = np.bincount(run, state & State.LOWER_BOUND, runs) > 0
    is_beyond = ~np.isnan(value) & ~(np.abs(value) <= LARGEST)
    has_huge = np.bincount(run, is_beyond, runs) > 0
    is_known = ~np.isnan(value) & ~(is_bounded | has_huge)[run]
    counts = np.bincount(run[is_known], minlength=runs)
    row_counts = np.bincount(run, minlength=runs)
    lower, upper = _limits(table, rows)
    warnings = [
        *unit_warnings,
        *absent_warnings,
        *_name_too_large(table, run[is_beyond], value[is_beyond]),
        *_sensors(_NOT_MEASURED, table, np.flatnonzero((row_counts > 0) & (counts == 0) & ~is_bounded & ~has_huge)),
        *_sensors(_LOWER_BOUND, table, np.flatnonzero(is_bounded)),
        *_sensors(
            _FEWER, table, np.flatnonzero((counts > 0) & (counts < row_counts.max())), most=str(row_counts.max())
        ),
        *([_SEVERAL_LIMITS] if len({(kind.lower, kind.upper) for kind in kinds}) > 1 else []),
    ]
    return MetricValues(
        key=key,
        title=title,
        unit=kinds[0].unit,
        lower=lower,
        upper=upper,
        mean=_means(run[is_known], value[is_known], runs),
        least=_extremes(np.minimum, run[is_known], value[is_known], runs),
        most=_extremes(np.maximum, run[is_known], value[is_known], runs),
        per_run=int(row_counts.max()),
        at=_average_by_location(table, rows[is_known], runs),
        failed=np.bincount(run, state & (State.FAILED | State.UNMEASURED), runs) > 0,
        warnings=tuple(warnings),
    )


def _means(run: NDArray[np.int32], value: Array, runs: int) -> Array:
    counts = np.bincount(run, minlength=runs)
    sums = np.bincount(run, value, runs)
    means: Array = np.full(runs, np.nan)
    np.divide(sums, counts, out=means, where=counts > 0)
    return means


def _extremes(pick: np.ufunc, run: NDArray[np.int32], value: Array, runs: int) -> Array:
    extremes: Array = np.full(runs, np.inf if pick is np.minimum else -np.inf)
    pick.at(extremes, run, value)
    extremes[np.isinf(extremes)] = np.nan
    return extremes


def _average_by_location(table: FleetTable, rows: NDArray[np.intp], runs: int) -> dict[str, Array]:
    members: dict[str, list[int]] = {}
    for index in np.unique(table.kind[rows]):
        members.setdefault(table.kinds[index].location, []).append(int(index))
    members.pop("", None)
    means = {}
    for location, indices in sorted(members.items()):
        location_rows = rows[np.isin(table.kind[rows], indices)]
        means[location] = _means(table.run[location_rows], table.value[location_rows], runs)
    return means


def _keep_one_unit(table: FleetTable, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], list[str]]:
    """Keep the most common unit; report values in others."""
    counts: Counter[str] = Counter()
    for index, count in zip(*np.unique(table.kind[rows], return_counts=True), strict=True):
        counts[table.kinds[index].unit] += int(count)
    (unit, _), *other_counts = counts.most_common()
    if not other_counts:
        return rows, []
    has_unit = np.array([kind.unit == unit for kind in table.kinds])[table.kind[rows]]
    other_units = ", ".join(name for name, _ in other_counts)
    runs_left_out = np.unique(table.run[rows[~has_unit]]).astype(np.intp)
    return rows[has_unit], list(_sensors(_OTHER_UNIT, table, runs_left_out, other=other_units, unit=unit))


def _absent(table: FleetTable, rows: NDArray[np.intp], used: BoolArray) -> Iterator[str]:
    """Name runs that count but do not have such a metric, not even as missing."""
    has_metric = np.zeros(len(table.runs), dtype=np.bool_)
    has_metric[table.run[rows]] = True
    runs_without = np.flatnonzero(used & ~has_metric)
    if not len(runs_without):
        return
    measuring_recipes = {table.runs[run].recipe for run in np.flatnonzero(has_metric)}
    other_recipes = [
        table.runs[run].recipe for run in runs_without if table.runs[run].recipe not in measuring_recipes
    ]
    unmeasured_runs = [run for run in runs_without if table.runs[run].recipe in measuring_recipes]
    yield from _sensors(_NEVER_MEASURED, table, np.array(unmeasured_runs, dtype=np.intp))
    if other_recipes:
        yield _OTHER_RECIPE.format(
            runs=plural(len(other_recipes), "run"), recipes=list_names(sorted(set(other_recipes)))
        )


def _name_too_large(table: FleetTable, run: NDArray[np.int32], value: Array) -> Iterator[str]:
    """Name values that are too large for arithmetic."""
    sensors = {f"{table.runs[index].serial} ({number:g})" for index, number in zip(run, value, strict=True)}
    if sensors:
        yield _BEYOND.format(values=list_names(sorted(sensors)))


def _sensors(template: str, table: FleetTable, runs: NDArray[np.intp], **words: str) -> Iterator[str]:
    """Fill a template with the sensors of runs, if any; several runs are counted."""
    if len(runs):
        serials = list_names(sorted({table.runs[run].serial for run in runs}))
        yield template.format(sensors=f"{serials} ({plural(len(runs), 'run')})", **words)


def _limits(table: FleetTable, rows: NDArray[np.intp]) -> tuple[float | None, float | None]:
    limited = np.array([kind.lower is not None or kind.upper is not None for kind in table.kinds])
    judged = rows[limited[table.kind[rows]]]
    if not len(judged):
        return None, None
    kind = table.kinds[table.kind[judged[np.argmax(table.run[judged])]]]
    return kind.lower, kind.upper
