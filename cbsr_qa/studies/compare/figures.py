"""One figure a run and metric: the mean over the loads of its recipe where there is one value a load.

The limits of a recipe judge every load, so that the least and the greatest value are kept beside the mean.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain import Array
from cbsr_qa.domain.results import FleetTable, Kind, MetricKey, State
from cbsr_qa.report import plural
from cbsr_qa.stats import LARGEST

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class MetricFigures:
    """A metric of every run.

    Parameters
    ----------
    unit : of all values that were taken.
    lower, upper : limit of the latest run that had one; None where there is none.
    mean, least, most : (R,) of each run's values; NaN where it has none, or where one is only a lower bound, infinite
        or beyond what can be squared.
    per_run : values of the run that has most.
    at : location → (R,) mean of the values there; empty where values have no location.
    failed : (R,) whether a value was outside its limit or, though limited, could not be measured.
    warnings : what was left out, and what is not alike, in sentences.
    """

    key: MetricKey
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
    def limited(self) -> bool:
        """Whether its recipe limits it."""
        return self.lower is not None or self.upper is not None


def figures_of(table: FleetTable, used: BoolArray) -> Iterator[MetricFigures]:
    """Return the figures of each metric, in the order the metrics were measured in.

    Parameters
    ----------
    used : (R,) runs that count; values of the others are left out.
    """
    keys = list(dict.fromkeys(kind.key for kind in table.kinds))
    if not keys:  # no run holds a measurement
        return
    places = {key: place for place, key in enumerate(keys)}
    of_kind = np.array([places[kind.key] for kind in table.kinds], dtype=np.intp)
    rows = np.flatnonzero(used[table.run]) if len(table.run) else np.zeros(0, dtype=np.intp)
    metric = of_kind[table.kind[rows]]
    order = rows[np.argsort(metric, kind="stable")]
    ends = np.cumsum(np.bincount(metric, minlength=len(keys)))
    for key, chosen in zip(keys, np.split(order, ends[:-1]), strict=True):
        if len(chosen):
            yield _figures(key, table, chosen, used)


def _figures(key: MetricKey, table: FleetTable, rows: NDArray[np.intp], used: BoolArray) -> MetricFigures:
    absent = _absent(table, rows, used)
    rows, mixed = _one_unit(table, rows)
    run, value, state = table.run[rows], table.value[rows], table.state[rows]
    kinds = [table.kinds[index] for index in np.unique(table.kind[rows])]
    runs = len(table.runs)
    bounded = np.bincount(run, state & State.LOWER_BOUND, runs) > 0
    beyond = ~np.isnan(value) & ~(np.abs(value) <= LARGEST)
    huge = np.bincount(run, beyond, runs) > 0
    known = ~np.isnan(value) & ~(bounded | huge)[run]
    counts = np.bincount(run[known], minlength=runs)
    asked = np.bincount(run, minlength=runs)
    limits = _limits(table, rows)
    without = _missing(table, asked, counts, bounded, huge)
    warnings = [*mixed, *absent, *_beyond(table, run[beyond], value[beyond]), *without, *_several_limits(kinds)]
    return MetricFigures(
        key=key,
        unit=kinds[0].unit,
        lower=limits[0],
        upper=limits[1],
        mean=_means(run[known], value[known], runs),
        least=_extremes(np.minimum, run[known], value[known], runs),
        most=_extremes(np.maximum, run[known], value[known], runs),
        per_run=int(asked.max()),
        at=_by_location(table, rows[known], runs),
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
    found: Array = np.full(runs, np.inf if pick is np.minimum else -np.inf)
    pick.at(found, run, value)
    found[np.isinf(found)] = np.nan
    return found


def _by_location(table: FleetTable, rows: NDArray[np.intp], runs: int) -> dict[str, Array]:
    members: dict[str, list[int]] = {}
    for index in np.unique(table.kind[rows]):
        members.setdefault(table.kinds[index].location, []).append(int(index))
    members.pop("", None)
    found = {}
    for location, indices in sorted(members.items()):
        here = rows[np.isin(table.kind[rows], indices)]
        found[location] = _means(table.run[here], table.value[here], runs)
    return found


def _one_unit(table: FleetTable, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], list[str]]:
    """Keep the unit most values are in; say what is in another."""
    counts: Counter[str] = Counter()
    for index, count in zip(*np.unique(table.kind[rows], return_counts=True), strict=True):
        counts[table.kinds[index].unit] += int(count)
    (unit, _), *others = counts.most_common()
    if not others:
        return rows, []
    same = np.array([kind.unit == unit for kind in table.kinds])
    out = rows[~same[table.kind[rows]]]
    sensors = sorted({table.runs[run].serial for run in np.unique(table.run[out])})
    said = ", ".join(other for other, _ in others)
    return rows[same[table.kind[rows]]], [
        f"mixed units: {named(sensors)} measured it in {said} instead of {unit} and are left out of it"
    ]


def _absent(table: FleetTable, rows: NDArray[np.intp], used: BoolArray) -> Iterator[str]:
    """Runs that count and hold no such metric at all, not even as missing."""
    has = np.zeros(len(table.runs), dtype=np.bool_)
    has[table.run[rows]] = True
    without = np.flatnonzero(used & ~has)
    if not len(without):
        return
    measuring = {table.runs[run].recipe for run in np.flatnonzero(has)}
    strayed = np.array([run for run in without if table.runs[run].recipe in measuring], dtype=np.intp)
    if len(strayed):
        said = plural(
            len(strayed), "run does not hold it and is left out of it", "runs do not hold it and are left out of it"
        )
        yield f"{said}: {_sensors(table, strayed)}"
    others = sorted({table.runs[run].recipe for run in without} - measuring)
    if others:
        left = plural(len(without) - len(strayed), "run is left out", "runs are left out")
        yield f"{left} of it, of recipes that do not measure it: {named(others)}"


def _beyond(table: FleetTable, run: NDArray[np.int32], value: Array) -> Iterator[str]:
    """Name values that no arithmetic can be done with."""
    if len(run):
        said = plural(len(set(run.tolist())), "run has a value that is", "runs have values that are")
        shown = sorted({f"{table.runs[one].serial} ({number:g})" for one, number in zip(run, value, strict=True)})
        yield f"{said} infinite or beyond {LARGEST:g}, left out of it: {named(shown)}"


def _missing(
    table: FleetTable, asked: NDArray[np.intp], counts: NDArray[np.intp], bounded: BoolArray, huge: BoolArray
) -> Iterator[str]:
    none = np.flatnonzero((asked > 0) & (counts == 0) & ~bounded & ~huge)
    if len(none):
        said = plural(
            len(none), "run could not measure it and is left out", "runs could not measure it and are left out"
        )
        yield f"{said}: {_sensors(table, none)}"
    lower = np.flatnonzero(bounded)
    if len(lower):
        yield f"of {plural(len(lower), 'run')} only a lower bound is known; left out: {_sensors(table, lower)}"
    some = np.flatnonzero((counts > 0) & (counts < asked.max()))
    if len(some):
        said = plural(len(some), "run lacks", "runs lack")
        yield f"{said} some of the {asked.max()} values; the figure is the rest's mean: {_sensors(table, some)}"


def _limits(table: FleetTable, rows: NDArray[np.intp]) -> tuple[float | None, float | None]:
    """Limits of the latest run that had some."""
    limited = np.array([kind.lower is not None or kind.upper is not None for kind in table.kinds])
    judged = rows[limited[table.kind[rows]]]
    if not len(judged):
        return None, None
    kind = table.kinds[table.kind[judged[np.argmax(table.run[judged])]]]
    return kind.lower, kind.upper


def _several_limits(kinds: Sequence[Kind]) -> list[str]:
    limits = {(kind.lower, kind.upper) for kind in kinds}
    if len(limits) < 2:
        return []
    return ["runs were held against different limits; capability is against those of the latest run"]


def _sensors(table: FleetTable, runs: NDArray[np.intp]) -> str:
    return named(sorted({table.runs[run].serial for run in runs}))


def named(names: Sequence[str], most: int = 5) -> str:
    """List names; of very many the first ones."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")
