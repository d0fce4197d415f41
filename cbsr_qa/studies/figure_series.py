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
    keys = [
        (replace(entry.key, location=entry.location) if by_location else entry.key, entry.unit)
        for entry in table.kinds
    ]
    columns = sorted(set(keys))
    places = {key: place for place, key in enumerate(columns)}
    column = np.array([places[key] for key in keys], dtype=np.intp)
    limits = np.array([(entry.lower, entry.upper) for entry in table.kinds], dtype=np.float64).reshape(-1, 2)
    cells, cell = np.unique(table.run.astype(np.intp) * len(columns) + column[table.kind], return_inverse=True)
    lower, upper = np.full((2, len(cells)), np.nan)
    np.fmax.at(lower, cell, limits[table.kind, 0])
    np.fmin.at(upper, cell, limits[table.kind, 1])
    counts = np.bincount(cell)
    missing_counts = np.bincount(cell, np.isnan(table.value))
    bounded_counts = np.bincount(cell, table.state & State.LOWER_BOUND > 0)
    means = np.bincount(cell, table.value) / counts
    numbers = (entry.tolist() for entry in (cells, means, counts, missing_counts, bounded_counts, lower, upper))
    by_key: dict[MetricKey, dict[str, RunFigure]] = {}
    for cell_number, mean, count, absent, bounds, low, high in zip(*numbers, strict=True):
        run, (key, unit) = table.runs[cell_number // len(columns)].run, columns[cell_number % len(columns)]
        value = None if absent or bounds else mean
        ends = [None if isnan(end) else end for end in (low, high)]
        figure = RunFigure(run, key, unit, value, count, int(absent), int(bounds), ends[0], ends[1])
        figures_by_run = by_key.setdefault(key, {})
        if run in figures_by_run:  # in another unit
            other = figures_by_run[run]
            larger = max(other, figure, key=lambda one: one.places)
            units = tuple(sorted({*(other.units or (other.unit,)), unit}))
            figure = replace(larger, value=None, places=other.places + count, units=units)
        figures_by_run[run] = figure
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
    run_ids = {run.run for run in runs}
    by_key = {
        key: selected_figures
        for key, figures_by_run in figures.items()
        if (selected_figures := {run: figures_by_run[run] for run in figures_by_run if run in run_ids})
    }
    if not by_key:
        raise RefusedError("none of these runs has measurements", remedy="choose runs that were finished")
    measured_names = {key.name for key in by_key}
    for name in names:
        if name not in measured_names:
            raise missing_metric_error(name, measured_names)
    limited_keys = [
        key
        for key, figures_by_run in by_key.items()
        if any(figure.lower is not None or figure.upper is not None for figure in figures_by_run.values())
    ]
    chosen_keys = [key for key in by_key if key.name in names] if names else limited_keys or list(by_key)
    return [_series(key, runs, by_key[key]) for key in chosen_keys]


def _series(key: MetricKey, runs: Sequence[RunLine], figures: Mapping[str, RunFigure]) -> Series:
    run_figures = [figures[run.run] for run in runs if run.run in figures]
    single_unit_figures = [figure for figure in run_figures if not figure.units] or run_figures
    unit = _find_most_common(figure.unit for figure in single_unit_figures)
    places = _find_most_common(figure.places for figure in single_unit_figures if figure.unit == unit)
    valued_runs: list[tuple[RunLine, float]] = []
    runs_by_reason: dict[str, list[str]] = {}
    for run in runs:
        figure = figures.get(run.run)
        reason = _why_not(figure, unit, places)
        if reason:
            runs_by_reason.setdefault(reason, []).append(run.words)
        elif figure is not None and figure.value is not None:
            valued_runs.append((run, figure.value))
    notes = tuple(f"left out: {reason}: {list_names(run_words)}" for reason, run_words in runs_by_reason.items())
    lines, values = tuple(run for run, _ in valued_runs), tuple(value for _, value in valued_runs)
    return Series(key, unit, lines, values, run_figures[-1].lower, run_figures[-1].upper, notes)


def _why_not(figure: RunFigure | None, unit: str, places: int) -> str:
    """Why a run's value is not comparable with the others; empty if it is."""
    if figure is None:
        return "did not measure it"
    if figure.unit != unit and not figure.units:
        return f"in {figure.unit} instead of {unit}"
    if figure.value is None:
        return figure.why
    return "" if figure.places == places else f"the mean of {figure.places} values instead of {places}"


def _find_most_common(values: Iterable[_T]) -> _T:
    return Counter(values).most_common(1)[0][0]
