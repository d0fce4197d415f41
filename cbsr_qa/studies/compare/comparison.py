"""A whole comparison: groups, every metric with its p values adjusted for all, and cautions."""

import gc
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import chain
from typing import Annotated, Final

import numpy as np
from pydantic import Field, InstanceOf

from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.fleet import FleetTable, RunLine, RunSelection
from cbsr_qa.stats.crossings import Crossing, IntArray
from cbsr_qa.stats.difference import benjamini_hochberg, holm
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.compare.cautions import cautions
from cbsr_qa.studies.compare.describe import Distribution, Group, distribution, groups_of
from cbsr_qa.studies.compare.differences import (
    Difference,
    Estimated,
    StationDifference,
    compare_places,
    difference,
    stations_above,
)
from cbsr_qa.studies.compare.groups import Design, Grouping, choose_reference, design_of, group_runs
from cbsr_qa.studies.compare.models import Fitted, fit_model, include_sessions
from cbsr_qa.studies.compare.terms import Adjustment, By, Policy, Quarantine, Terms
from cbsr_qa.studies.compare.values import MetricValues, values_of
from cbsr_qa.studies.selection import WayCount, add_ways, check_names, count_ways, missing_metric_error

#: The common error of all places of a grid comes from seating the disc and from the axes: the station, not the
#: sensor.
OF_THE_STATION: Final = ("registration_shift", "registration_rotation", "registration_scale")
_ELSEWHERE: Final = "on other stations"
_APART: Final = f"not compared with groups {_ELSEWHERE}"
_SHARES_PLACES: Final = {"centre_of_mass_error": "registered_centre_of_mass_error"}

# Cautions about one metric.
_STATIONS_ALONE: Final = (
    "it describes how a station places sensors, so it is compared between stations, not between groups"
)
_HOLDS_SHARED: Final = "it includes the shift of all places, which depends on how the station places sensors"
_IS_WITHOUT: Final = "; {other} does not"


@dataclass(frozen=True, slots=True, eq=False)
class MetricComparison:
    """One metric.

    Parameters
    ----------
    differences : difference of each other group from the reference; empty if the metric belongs to the station alone.
    stations : difference of each other station from the first; empty for one station, or if stations are the groups.
    samples : (group, station, values of sensors), for plots.
    notes : weaknesses of design and fit, and omissions.
    """

    values: MetricValues
    differences: tuple[Difference, ...]
    stations: tuple[StationDifference, ...]
    distributions: tuple[Distribution, ...]
    samples: tuple[tuple[str, str, Array], ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A comparison with its results.

    Parameters
    ----------
    compared : whether any difference could be estimated.
    metrics : difference in each metric for each other group; one entry without a group if a metric is not compared.
    of_metrics : the same differences, metric by metric, with data for plots.
    ways : how the calibrations of the runs were made.
    headline, sentences, rules : filled in by :func:`cbsr_qa.studies.compare.report.compare_outcome`.
    """

    by: By
    reference: str
    compared: bool
    policy: Policy
    quarantine: Quarantine
    adjustment: Adjustment
    confidence: float
    recipes: tuple[str, ...]
    simulated: tuple[str, ...]
    groups: tuple[Group, ...]
    metrics: tuple[Difference, ...]
    stations: tuple[StationDifference, ...]
    distributions: tuple[Distribution, ...]
    warnings: tuple[str, ...]
    ways: tuple[WayCount, ...]
    terms: Annotated[InstanceOf[Terms], Field(exclude=True)]
    of_metrics: Annotated[tuple[InstanceOf[MetricComparison], ...], Field(exclude=True)]
    headline: str = ""
    sentences: tuple[str, ...] = ()
    rules: tuple[str, ...] = ()

    @property
    def pairs(self) -> Iterator[tuple[MetricComparison, Difference]]:
        """All differences with their metrics."""
        return ((metric, difference) for metric in self.of_metrics for difference in metric.differences)

    @property
    def all_stations(self) -> list[str]:
        return sorted({name for group in self.groups for name in group.stations})

    @property
    def all_batches(self) -> list[str]:
        return sorted({name for group in self.groups for name in group.batches})

    @property
    def others(self) -> str:
        """Factors not to be mistaken for groups: batches too, if periods or software versions are compared."""
        if self.by is By.STATION:
            return "batches"
        mixed = self.by in (By.PERIOD, By.SOFTWARE) and len(self.all_batches) > 1
        return "stations and batches" if mixed else "stations"

    def significant(self, difference: Estimated) -> bool:
        """Whether an adjusted p value is below the level."""
        return difference.p is not None and difference.p < self.terms.level

    def side(self, metric: MetricComparison, difference: Estimated) -> str:
        """Compare a group with its reference: worse or better if a single limit decides, else higher or lower."""
        is_above, values = (difference.difference or 0.0) > 0, metric.values
        one_limit = (values.lower is None) != (values.upper is None)
        if one_limit and isinstance(difference, Difference) and self.by is not By.STATION:
            return "worse than" if is_above is (values.lower is None) else "better than"
        return "higher than" if is_above else "lower than"


def compare_groups(selection: RunSelection, terms: Terms, *, database: str | None, now: datetime) -> Comparison:
    """Compare groups of stored runs.

    Raises
    ------
    RefusedError
        If no run fits, or a named recipe, group or metric does not exist (with the nearest name).
    StoreError
        If the database is missing or cannot be read.
    """
    with _pause_collector(), open_store(database_url(database), create=False) as store:
        table = store.fleet.load_table(selection)
        if not table.runs:
            check_names(store, selection)
        return compare(replace(table, runs=add_ways(store, table.runs)), terms, now)


@contextmanager
def _pause_collector() -> Iterator[None]:
    """Disable garbage collection: a million values have no cycles, and it takes a third of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def compare(table: FleetTable, terms: Terms, now: datetime) -> Comparison:
    """Compare groups of runs in every metric.

    Parameters
    ----------
    now : time of the computer's clock, to recognise future times.

    Raises
    ------
    RefusedError
        If no run counts, or a named group or metric does not exist (with the nearest name).
    """
    grouping = group_runs(table.runs, terms)
    all_values = list(values_of(table, grouping.used))
    chosen_values = _choose_metrics(all_values, terms)
    design = design_of(table.runs, grouping, terms)
    means = np.array([values.mean for values in all_values]).reshape(-1, len(table.runs))
    grouping, reference_notes = choose_reference(grouping, design, np.any(~np.isnan(means), axis=0), terms)
    deciding = grouping.deciding(table.runs, terms.policy)
    models, station_models = _fit_models(chosen_values, design)
    unadjusted = [
        _compare_metric(values, model, station_model, table, grouping, deciding, design)
        for values, model, station_model in zip(chosen_values, models, station_models, strict=True)
    ]
    metrics = _adjust_p_values(unadjusted, terms)
    members = [run for run, is_used in zip(table.runs, grouping.used, strict=True) if is_used]
    differences = tuple(
        chain.from_iterable(
            metric.differences or (Difference(*metric.values.identity, reference=None, warnings=metric.notes),)
            for metric in metrics
        )
    )
    return fill_from_object(
        Comparison,
        terms,
        reference=grouping.reference,
        compared=any(difference.known for difference in differences),
        recipes=tuple(sorted({run.recipe for run in members})),
        simulated=tuple(sorted({words for simulated in {run.simulated for run in members} for words in simulated})),
        groups=tuple(groups_of(table.runs, grouping, all_values, terms)),
        metrics=differences,
        stations=tuple(chain.from_iterable(metric.stations for metric in metrics)),
        distributions=tuple(chain.from_iterable(metric.distributions for metric in metrics)),
        warnings=(*reference_notes, *cautions(members, grouping, design, models, terms, now)),
        ways=count_ways(members),
        terms=terms,
        of_metrics=tuple(metrics),
    )


def _choose_metrics(every: Sequence[MetricValues], terms: Terms) -> list[MetricValues]:
    measured_names = {values.key.name for values in every}
    for name in (*terms.names, *terms.margins, *terms.detect, *filter(None, terms.distributions)):
        if name not in measured_names:
            raise missing_metric_error(name, measured_names)
    options = {"--margin": terms.margins, "--detect": terms.detect, "--distribution": terms.distributions}
    for option, asked in options.items():
        for name in asked if terms.names else ():
            if name and name not in terms.names:
                raise RefusedError(
                    f"{option} states {name!r}, which is not among the metrics to compare: {', '.join(terms.names)}",
                    remedy=f"name it too (--metric {name}), or leave its {option} out",
                )
    return [values for values in every if not terms.names or values.key.name in terms.names]


def _fit_models(metrics: Sequence[MetricValues], design: Design) -> tuple[list[Fitted], list[Fitted]]:
    """Fit the models of groups and of stations; sessions disturb metrics together, and are looked for in all."""

    def fit_all(made: Crossing, *, of_stations: bool) -> list[Fitted]:
        return include_sessions(
            [
                fit_model(made, metric.mean[design.rows], metric.key.label, of_stations=of_stations)
                for metric in metrics
            ]
        )

    models = fit_all(design.crossing, of_stations=design.of_stations)
    if design.of_the_stations is design.crossing or not design.stations:
        return models, models
    return models, fit_all(design.of_the_stations, of_stations=True)


def _compare_metric(
    metric: MetricValues,
    model: Fitted,
    station_model: Fitted,
    table: FleetTable,
    grouping: Grouping,
    deciding: Mapping[str, IntArray],
    design: Design,
) -> MetricComparison:
    """Compare groups and stations in one metric by the deciding runs; p values are not adjusted yet."""
    is_station_metric = metric.key.name in OF_THE_STATION and not design.of_stations and len(design.stations) > 1
    indices_by_group = {name: indices[~np.isnan(metric.mean[indices])] for name, indices in deciding.items()}
    notes = _notes(model, metric, table, design, of_station=is_station_metric)
    pairs = [(name, grouping.reference) for name in grouping.names[1:] if not is_station_metric]
    places = compare_places(metric, table, pairs, design)
    differences = [difference(model, metric, indices_by_group, pair, design) for pair in pairs]
    return MetricComparison(
        values=metric,
        differences=tuple(
            replace(pair, places=places.get(str(pair.group), ()), warnings=(*pair.warnings, *notes))
            for pair in differences
        ),
        stations=tuple(stations_above(station_model, metric, design)),
        distributions=tuple(
            distribution(metric, table.runs, name, indices_by_group[name], design.terms) for name in grouping.names
        ),
        samples=_samples(metric, table.runs, indices_by_group),
        notes=notes,
    )


def _samples(
    metric: MetricValues, runs: Sequence[RunLine], known: Mapping[str, IntArray]
) -> tuple[tuple[str, str, Array], ...]:
    samples = []
    for name, indices in known.items():
        indices_by_station: dict[str, list[int]] = {}
        for index in indices.tolist():
            indices_by_station.setdefault(runs[index].station, []).append(index)
        samples += [(name, station, metric.mean[members]) for station, members in sorted(indices_by_station.items())]
    return tuple(samples)


def _notes(
    model: Fitted, metric: MetricValues, table: FleetTable, design: Design, *, of_station: bool
) -> tuple[str, ...]:
    notes = [*metric.warnings, *(model.fit.notes if model.fit else ())]
    if design.levels:
        # The model's stations are batches at stations; metrics that are not compared are reported elsewhere.
        notes = [note.replace(_ELSEWHERE, "of other batches or stations") for note in notes if _APART not in note]
    if of_station:
        notes.append(_STATIONS_ALONE)
    other_metric = _SHARES_PLACES.get(metric.key.name)
    if other_metric is not None:
        is_measured = any(kind.key.name == other_metric for kind in table.kinds)
        notes.append(_HOLDS_SHARED + (_IS_WITHOUT.format(other=other_metric) if is_measured else ""))
    return tuple(notes)


def _adjust_p_values(metrics: Sequence[MetricComparison], terms: Terms) -> list[MetricComparison]:
    """Adjust p values: jointly for all groups, for all equivalence tests, and for all stations."""
    all_differences = [difference for metric in metrics for difference in metric.differences]
    group_p_values = iter(_adjust([test.p_unadjusted for test in all_differences], terms.adjustment))
    equivalence_p_values = iter(
        _adjust([test.equivalence_p_unadjusted for test in all_differences], terms.adjustment)
    )
    station_p_values = iter(
        _adjust([station.p_unadjusted for metric in metrics for station in metric.stations], terms.adjustment)
    )

    def with_p(difference: Difference) -> Difference:
        equivalence_p = next(equivalence_p_values)
        is_equivalent = None if equivalence_p is None else equivalence_p <= terms.level
        return replace(difference, p=next(group_p_values), equivalence_p=equivalence_p, equivalent=is_equivalent)

    return [
        replace(
            metric,
            differences=tuple(map(with_p, metric.differences)),
            stations=tuple(replace(test, p=next(station_p_values)) for test in metric.stations),
        )
        for metric in metrics
    ]


def _adjust(p_values: Sequence[float | None], adjustment: Adjustment) -> list[float | None]:
    known_p_values = [p for p in p_values if p is not None]
    method = {Adjustment.HOLM: holm, Adjustment.BENJAMINI_HOCHBERG: benjamini_hochberg}.get(adjustment)
    adjusted = iter(known_p_values if method is None else method(known_p_values).tolist())
    return [None if p is None else float(next(adjusted)) for p in p_values]
