"""Gauge R&R from stored runs: sensors are the parts, stations or operators appraise, repeated runs are trials.

A study with missing runs is refused, and the refusal names them.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import Annotated

from pydantic import Field, InstanceOf

from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.numbers import prefix_kind
from cbsr_qa.domain.results.fleet import FleetTable, KnownNames, MetricKey, RunLine, RunSelection
from cbsr_qa.report.tables import list_names, plural
from cbsr_qa.stats.gauge.anova import GaugeAnova, gauge_anova
from cbsr_qa.stats.gauge.balance import largest_balanced, missing_runs
from cbsr_qa.stats.gauge.crossed_study import GaugeRange, Study, gauge_range, on, study
from cbsr_qa.stats.gauge.nested import NestedStudy, nested_anova, nested_study, uneven_parts
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.studies.gauge.metrics import Toleranced, choose_metrics
from cbsr_qa.studies.gauge.references import AgainstReferences, compare_references
from cbsr_qa.studies.gauge.request import GaugeRequest, StudySource
from cbsr_qa.studies.selection import (
    WayCount,
    absent_names,
    add_ways,
    check_names,
    clock_notes,
    count_ways,
    describe_recipes,
    describe_several_ways,
    likeness_notes,
)


def appraiser_of(line: RunLine, kind: str) -> str:
    """Return who or what appraised a run: its station or its operator."""
    return line.station if kind == "station" else line.operator


def choose_runs(store: Repository, request: GaugeRequest) -> tuple[FleetTable, tuple[RunLine, ...], tuple[str, ...]]:
    """Return stored values, the indices of a study's runs, and notes on them.

    RefusedError if no run fits, a name matches none (with the nearest one), or the runs have several recipes.
    """
    table = store.fleet.load_table(request.runs)
    runs = tuple(run for run in table.runs if run.outcome is not None)
    _check_found(store, request, runs)
    recipes = {run.recipe for run in runs}
    if len(recipes) > 1:
        raise RefusedError(
            f"{request.locate('study')}these runs are of {describe_recipes(recipes)}",
            remedy="choose one by its name: recipe in the study, or --recipe",
        )
    studied_runs = tuple(run for run in runs if appraiser_of(run, request.appraiser))
    if not studied_runs:
        raise RefusedError(f"none of these runs names its {request.appraiser}", remedy="study stations instead")
    notes = clock_notes(studied_runs)
    if len(studied_runs) < len(runs):
        unknown = plural(len(runs) - len(studied_runs), "run")
        notes += (f"left out: {unknown} without the name of the {request.appraiser}",)
    return table, studied_runs, notes


def _check_found(store: Repository, request: GaugeRequest, runs: Sequence[RunLine]) -> None:
    """Refuse names without a run, each with its line in the study's file; unknown names come first."""
    known = KnownNames(
        recipes=frozenset(run.recipe for run in runs),
        batches=frozenset(run.batch for run in runs),
        serials=frozenset(run.serial for run in runs),
        stations=frozenset(run.station for run in runs),
        operators=frozenset(run.operator for run in runs),
        parts=frozenset(part for run in runs for part in run.parts),
    )
    selection, absent = request.runs, list(absent_names(request.runs, known))
    if runs and not absent:
        return
    check_names(store, selection, lambda field: request.locate("study", field))
    # Its sensors and recipe, at any station and on any day.
    runs_of_names = store.fleet.read_lines(RunSelection(serials=selection.serials, recipe=selection.recipe))
    days = sorted(run.day for run in runs_of_names)
    day_words = f"; runs of its sensors and recipe began from {days[0]} to {days[-1]}" if days else ""
    remedy = f"choose other days, other names or another recipe{day_words}"
    # Without any matching run every name is absent, so that names are not the cause.
    if runs:
        refusals = [
            f"{request.locate('study', key)}{prefix_kind(noun, name)} has no analysed run that fits"
            for noun, key, name, _ in absent
        ]
        raise RefusedError("\n".join(refusals), remedy=remedy)
    raise RefusedError(f"{request.locate('study')}no analysed run fits this study", remedy=remedy)


@dataclass(frozen=True, slots=True, eq=False)
class MetricGauge:
    """One metric's study.

    Parameters
    ----------
    tolerance, tolerance_of : the width that the gauge is compared with, of the ``"study"`` or the ``"recipe"``.
    runs : number of runs with a value.
    missing : missing and surplus runs of a balanced study, in words.
    why : reason for a missing study; ``sensors`` to ``average_range`` are then None.
    sensors : the parts; batches where these are nested.
    average_range : None for a nested study too, of which the method has none.
    crossing : the studied values, for the figure.
    """

    name: str
    unit: str
    phase: str
    qualifier: str
    location: str
    lower: float | None
    upper: float | None
    tolerance: float | None
    tolerance_of: str | None
    runs: int
    missing: tuple[str, ...]
    notes: tuple[str, ...]
    references: AgainstReferences | None
    why: str = ""
    sensors: tuple[str, ...] | None = None
    appraisers: tuple[str, ...] | None = None
    trials: int | None = None
    anova: GaugeAnova | None = None
    average_range: GaugeRange | None = None
    crossing: Annotated[InstanceOf[Study] | InstanceOf[NestedStudy] | None, Field(exclude=True)] = None

    @property
    def title(self) -> str:
        """Name in words with phase, qualifier and location."""
        return MetricKey(self.name, self.phase, self.qualifier, self.location).title


@dataclass(frozen=True, slots=True, eq=False)
class GaugeStudy:
    """Gauge study of stored runs.

    Parameters
    ----------
    study : file of the study; None for options.
    since, until : first and last day of the runs, UTC, as requested.
    ways : how the calibrations of the runs were made.
    """

    study: StudySource | None
    appraiser: str
    confidence: float
    since: date | None
    until: date | None
    by_location: bool
    largest_balanced: bool
    nested: str | None
    recipe: str
    sensors: tuple[str, ...]
    stations: tuple[str, ...]
    appraisers: tuple[str, ...]
    runs: tuple[str, ...]
    simulated: bool
    ways: tuple[WayCount, ...]
    notes: tuple[str, ...]
    metrics: tuple[MetricGauge, ...]


def gauge(request: GaugeRequest, *, database: str | None = None) -> GaugeStudy:
    """Study a gauge on stored runs.

    Raises
    ------
    RefusedError
        If the request contradicts itself, no stored run fits it, or no metric can be studied (with what is missing).
    """
    request.check()
    with open_store(database_url(database), create=False) as store:
        table, lines, notes = choose_runs(store, request)
        chosen_metrics = choose_metrics(table, request, lines)
        ways = count_ways(add_ways(store, lines))
        notes += likeness_notes(store, lines)
    if several := describe_several_ways(ways):
        notes += (f"calibrations were made in several ways, which a scatter may come from: {several}",)
    metrics = tuple(_metric(toleranced, request) for toleranced in chosen_metrics)
    sensors = tuple(sorted({line.serial for line in lines}))
    _check_any(metrics, sensors, request)
    return fill_from_object(
        GaugeStudy,
        request,
        study=request.source,
        since=request.runs.since,
        until=request.runs.until,
        recipe=lines[0].recipe,
        sensors=sensors,
        stations=tuple(sorted({line.station for line in lines})),
        appraisers=tuple(sorted({appraiser_of(line, request.appraiser) for line in lines})),
        runs=tuple(line.run for line in lines),
        simulated=bool(lines[-1].simulated),
        ways=ways,
        notes=notes,
        metrics=metrics,
    )


def _metric(wanted: Toleranced, request: GaugeRequest) -> MetricGauge:
    series, key = wanted.series, wanted.series.key
    appraisers = [appraiser_of(line, request.appraiser) for line in series.lines]
    if request.nested is not None:
        sensors = [line.batch if request.nested == "batch" else line.serial for line in series.lines]
        why, missing_cells = "", uneven_parts(sensors, appraisers, request.nested, request.appraiser)
    else:
        sensors = [line.serial for line in series.lines]
        why = _explain_no_repeats(sensors, appraisers, request.appraiser)
        missing_cells = () if why else missing_runs(sensors, appraisers, request.appraiser)
    unstudied = fill_from_object(
        MetricGauge,
        key,
        unit=series.unit,
        lower=series.lower,
        upper=series.upper,
        tolerance=wanted.tolerance,
        tolerance_of=wanted.of or None,
        runs=len(series.values),
        missing=missing_cells,
        notes=series.notes,
        references=compare_references(series, appraisers, request.references, request.confidence, wanted.tolerance),
        why=why,
    )
    if why:
        return unstudied
    indices: Sequence[int] = range(len(series.values))
    if missing_cells and request.largest_balanced:
        balanced = largest_balanced(sensors, appraisers)
        if not balanced.kept:
            crossed = f"twice each {on(request.appraiser)} the same two {request.appraiser}s"
            return replace(unstudied, why=f"no two sensors were run {crossed}: nothing is crossed")
        size = balanced.words(appraiser=f"{request.appraiser}s")
        balance_note = f"this is the largest balanced part of {len(series.values)} runs: {size}"
        unstudied, indices = replace(unstudied, notes=(*series.notes, balance_note)), balanced.kept
    rows = [(sensors[k], appraisers[k], series.values[k]) for k in indices]
    try:
        return _study_metric(unstudied, rows, request)
    except NumericsError as error:
        return replace(unstudied, why=error.reason)


def _explain_no_repeats(sensors: Sequence[str], appraisers: Sequence[str], appraiser: str) -> str:
    """State that no sensor was run twice by the same appraiser in any selection; empty otherwise."""
    cells = Counter(zip(sensors, appraisers, strict=True))
    if not cells or max(cells.values()) > 1 or min(len(set(sensors)), len(set(appraisers))) < 2:
        return ""
    place = "on a station" if appraiser == "station" else f"by an {appraiser}"
    return f"every sensor was run once {place}: repeatability needs at least two runs of each"


def _study_metric(bare: MetricGauge, rows: Sequence[tuple[str, str, float]], request: GaugeRequest) -> MetricGauge:
    """Study runs, (sensor, appraiser, value) of each."""
    if not rows:
        raise NumericsError("none of these runs has a value of it")
    sensors, appraisers, values = zip(*rows, strict=True)
    if request.nested is not None:
        nesting = nested_study(sensors, appraisers, values, part=request.nested, appraiser=request.appraiser)
        return replace(
            bare,
            sensors=nesting.parts,
            appraisers=nesting.stations,
            trials=nesting.shape[2],
            anova=nested_anova(nesting, tolerance=bare.tolerance, confidence=request.confidence),
            crossing=nesting,
        )
    for noun, names in (("sensor", set(sensors)), (request.appraiser, set(appraisers))):
        if len(names) < 2:
            raise NumericsError(f"there is only one {noun}, {names.pop()}")
    crossing = study(sensors, appraisers, values, appraiser=request.appraiser)
    return replace(
        bare,
        sensors=crossing.sensors,
        appraisers=crossing.stations,
        trials=crossing.shape[2],
        anova=gauge_anova(crossing, tolerance=bare.tolerance, confidence=request.confidence),
        average_range=gauge_range(crossing, tolerance=bare.tolerance),
        crossing=crossing,
    )


def _check_any(metrics: Sequence[MetricGauge], sensors: Sequence[str], request: GaugeRequest) -> None:
    if any(metric.anova is not None or metric.references is not None for metric in metrics):
        return
    first_metric = metrics[0]
    reason = f"{first_metric.title}: {first_metric.why}"
    reason += f"; uneven: {list_names(first_metric.missing)}" if first_metric.missing else ""
    reason += "".join(f"; {note}" for note in first_metric.notes)
    if len(metrics) > 1:
        others = "other metric" if len(metrics) == 2 else f"other {len(metrics) - 1} metrics"
        reason += f"\nthe {others} cannot be studied either"
    is_uneven = any(metric.missing for metric in metrics) and not request.largest_balanced
    remedy = "a study needs two sensors, on two stations (or by two operators), twice each, that differ"
    if request.nested is not None:
        remedy = f"a nested study needs two {request.appraiser}s, two parts that only it measures of each, twice each"
    elif is_uneven:
        remedy = "add the missing runs, or study the largest balanced part with --largest-balanced"
    if len(sensors) == 1:
        true_value = f"'{sensors[0]}.{first_metric.name}=VALUE±U {first_metric.unit}'"
        remedy += f"; a single sensor of known value makes a type 1 study (Cg, Cgk): --reference {true_value}"
    raise RefusedError(f"no gauge study can be made of these runs: {reason}", remedy=remedy)
