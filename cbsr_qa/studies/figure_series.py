"""Values of one metric over many runs: one unit, one number of places, with notes on omissions."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isnan
from typing import TypeVar

import numpy as np

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.results.fleet import FleetTable, MetricKey, RunFigure, RunLine, State
from cbsr_qa.report.tables import list_names
from cbsr_qa.studies.selection import missing_metric_error

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Series:
    """One metric over runs, in the order of the runs' names; limits are those of the latest run, None without."""

    key: MetricKey
    unit: str
    lines: tuple[RunLine, ...]
    values: tuple[float, ...]
    lower: float | None
    upper: float | None
    notes: tuple[str, ...]

    @property
    def tolerance(self) -> float | None:
        """Width of the limits; None without both."""
        return None if self.lower is None or self.upper is None else self.upper - self.lower


#: Metric → run → its value.
Figures = Mapping[MetricKey, Mapping[str, RunFigure]]


def figures_of(table: FleetTable, *, by_location: bool = False) -> dict[MetricKey, dict[str, RunFigure]]:
    """Return the mean of each metric of a run over its loads, or over those of each location.

    A metric in several units within a run has no value there, with a note.
    """
    keys = [(replace(of.key, location=of.location) if by_location else of.key, of.unit) for of in table.kinds]
    columns = sorted(set(keys))
    places = {key: place for place, key in enumerate(columns)}
    column = np.array([places[key] for key in keys], dtype=np.intp)
    limits = np.array([(of.lower, of.upper) for of in table.kinds], dtype=np.float64).reshape(-1, 2)
    cells, cell = np.unique(table.run.astype(np.intp) * len(columns) + column[table.kind], return_inverse=True)
    lower, upper = np.full((2, len(cells)), np.nan)
    np.fmax.at(lower, cell, limits[table.kind, 0])
    np.fmin.at(upper, cell, limits[table.kind, 1])
    counts = np.bincount(cell)
    missing = np.bincount(cell, np.isnan(table.value))
    bounded = np.bincount(cell, table.state & State.LOWER_BOUND > 0)
    means = np.bincount(cell, table.value) / counts
    numbers = (of.tolist() for of in (cells, means, counts, missing, bounded, lower, upper))
    by_key: dict[MetricKey, dict[str, RunFigure]] = {}
    for at, mean, count, absent, bounds, low, high in zip(*numbers, strict=True):
        run, (key, unit) = table.runs[at // len(columns)].run, columns[at % len(columns)]
        value = None if absent or bounds else mean
        ends = [None if isnan(end) else end for end in (low, high)]
        figure = RunFigure(run, key, unit, value, count, int(absent), int(bounds), ends[0], ends[1])
        of_key = by_key.setdefault(key, {})
        of_key[run] = _merge_units(of_key[run], figure) if run in of_key else figure
    return by_key


def series_of(runs: Sequence[RunLine], figures: Figures, names: Sequence[str] = ()) -> list[Series]:
    """Arrange values, one series per metric.

    Parameters
    ----------
    names : requested measurements, all variants of each; empty for those with limits, or for all if none has limits.

    Raises
    ------
    RefusedError
        If no run measured a name (with the nearest one), or no run measured anything.
    """
    of_runs = {run.run for run in runs}
    by_key = {key: own for key, of in figures.items() if (own := {run: of[run] for run in of if run in of_runs})}
    if not by_key:
        raise RefusedError("none of these runs has measurements", remedy="choose runs that were finished")
    measured = {key.name for key in by_key}
    for name in names:
        if name not in measured:
            raise missing_metric_error(name, measured)
    limited = [key for key, of in by_key.items() if any(_has_limit(figure) for figure in of.values())]
    wanted = [key for key in by_key if key.name in names] if names else limited or list(by_key)
    return [_series(key, runs, by_key[key]) for key in wanted]


def _has_limit(figure: RunFigure) -> bool:
    return figure.lower is not None or figure.upper is not None


def _merge_units(first: RunFigure, second: RunFigure) -> RunFigure:
    units = tuple(sorted({*(first.units or (first.unit,)), second.unit}))
    most = max(first, second, key=lambda figure: figure.places)
    return replace(most, value=None, places=first.places + second.places, units=units)


def _series(key: MetricKey, runs: Sequence[RunLine], figures: Mapping[str, RunFigure]) -> Series:
    there = [figures[run.run] for run in runs if run.run in figures]
    whole = [figure for figure in there if not figure.units] or there
    unit = _most(figure.unit for figure in whole)
    places = _most(figure.places for figure in whole if figure.unit == unit)
    kept: list[tuple[RunLine, float]] = []
    left: dict[str, list[str]] = {}
    for run in runs:
        figure = figures.get(run.run)
        why = _why_not(figure, unit, places)
        if why:
            left.setdefault(why, []).append(run.words)
        elif figure is not None and figure.value is not None:
            kept.append((run, figure.value))
    notes = tuple(f"left out: {why}: {list_names(who)}" for why, who in left.items())
    lines, values = tuple(run for run, _ in kept), tuple(value for _, value in kept)
    return Series(key, unit, lines, values, there[-1].lower, there[-1].upper, notes)


def _why_not(figure: RunFigure | None, unit: str, places: int) -> str:
    """Why a run's value is not comparable with the others; empty if it is."""
    if figure is None:
        return "did not measure it"
    if figure.unit != unit and not figure.units:
        return f"in {figure.unit} instead of {unit}"
    if figure.value is None:
        return figure.why
    return "" if figure.places == places else f"the mean of {figure.places} values instead of {places}"


def _most(values: Iterable[_T]) -> _T:
    return Counter(values).most_common(1)[0][0]
