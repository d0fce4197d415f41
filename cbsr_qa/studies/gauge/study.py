"""Gauge R&R from stored runs: sensors are the parts, stations or operators appraise, repeated runs are trials.

The runs of a gauge study, and what is said where they are not there.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches

from cbsr_qa.config import database_url, echo
from cbsr_qa.domain import NumericsError, RefusedError, of_kind
from cbsr_qa.domain.results import RunLine
from cbsr_qa.report import plural
from cbsr_qa.stats.gauge import (
    BalancedPart,
    GaugeAnova,
    GaugeRange,
    Study,
    gauge_anova,
    gauge_range,
    largest_balanced,
    missing_runs,
    on,
    study,
)
from cbsr_qa.store import Repository, RunFilter, open_store
from cbsr_qa.studies.figure_series import Series, clock_notes, named, recipe_note, software_note
from cbsr_qa.studies.gauge.metrics import Toleranced, wanted_metrics
from cbsr_qa.studies.gauge.references import AgainstReferences, against_references
from cbsr_qa.studies.gauge.request import GaugeRequest


@dataclass(frozen=True, slots=True)
class _Named:
    """One name of a request.

    Parameters
    ----------
    noun : what it is of.
    at : where it stands in the study's file.
    there : whether a run that fits has it.
    """

    noun: str
    name: str
    at: str
    there: bool


def appraiser_of(line: RunLine, kind: str) -> str:
    """Return who or what appraised a run: its station or its operator."""
    return line.station if kind == "station" else line.operator


def chosen_runs(store: Repository, request: GaugeRequest) -> tuple[tuple[RunLine, ...], tuple[str, ...]]:
    """Return the runs of a study, and what is to be said of them all.

    Raises
    ------
    RefusedError
        If none fits, a name is of no run (with the nearest one), or they are of several recipes.
    """
    of_names = store.run_lines(RunFilter(serials=request.serials, recipe=request.recipe))
    lines = tuple(line for line in of_names if request.takes(line))
    _check_found(store, request, of_names, lines)
    recipes = sorted({line.recipe for line in lines})
    if len(recipes) > 1:
        raise RefusedError(
            f"{request.at('study')}these runs are of {len(recipes)} recipes: {named(recipes)}",
            remedy="choose one by its name: recipe in the study, or --recipe",
        )
    nobody = [line for line in lines if not appraiser_of(line, request.appraiser)]
    lines = tuple(line for line in lines if appraiser_of(line, request.appraiser))
    if not lines:
        raise RefusedError(f"none of these runs names its {request.appraiser}", remedy="study stations instead")
    notes = clock_notes(lines)
    if nobody:
        notes += (f"left out: {plural(len(nobody), 'run')} without the name of the {request.appraiser}",)
    return lines, notes


def _check_found(
    store: Repository, request: GaugeRequest, of_names: Sequence[RunLine], lines: Sequence[RunLine]
) -> None:
    """Refuse names without a run, each with its line in the study's file; unknown names come first."""
    absent = [one for one in _names(request, lines) if not one.there]
    if lines and not absent:
        return
    stored = store.run_lines(RunFilter())
    known: dict[str, set[str]] = {
        "recipe": {run.recipe for run in stored},
        "sensor": {run.serial for run in stored},
        "station": {run.station for run in stored},
        "operator": {run.operator for run in stored},
    }
    unknown = [one for one in absent if one.name not in known[one.noun]]
    if unknown:
        said = [f"{one.at}no analysed run is of {one.noun} {echo(one.name, 64)}" for one in unknown]
        raise RefusedError("\n".join(said), remedy=_hint(unknown[0].name, known[unknown[0].noun]))
    remedy = f"choose other days, other names or another recipe{_days(of_names)}"
    # Without any run that fits, every name is absent, and it is no name that is wrong.
    if lines:
        said = [f"{one.at}{of_kind(one.noun, one.name)} has no analysed run that fits" for one in absent]
        raise RefusedError("\n".join(said), remedy=remedy)
    raise RefusedError(f"{request.at('study')}no analysed run fits this study", remedy=remedy)


def _names(request: GaugeRequest, lines: Sequence[RunLine]) -> Iterator[_Named]:
    if request.recipe is not None:
        yield _Named("recipe", request.recipe, request.at("study", "recipe"), bool(lines))
    for noun, key, wanted, there in (
        ("sensor", "serials", request.serials, {line.serial for line in lines}),
        ("station", "stations", request.stations, {line.station for line in lines}),
        ("operator", "operators", request.operators, {line.operator for line in lines}),
    ):
        for name in wanted:
            yield _Named(noun, name, request.at("study", key), name in there)


def _days(lines: Sequence[RunLine]) -> str:
    """Say when runs of the sensors and the recipe were begun, whatever the days and stations; empty without any."""
    days = sorted(line.day for line in lines)
    return f"; runs of its sensors and recipe began from {days[0]} to {days[-1]}" if days else ""


def _hint(name: str, known: Collection[str]) -> str:
    near = get_close_matches(name, known, n=1)
    return f"did you mean {near[0]!r}?" if near else "cbsr-qa db status shows which database is used"


@dataclass(frozen=True, slots=True, eq=False)
class MetricGauge:
    """One metric's study.

    Parameters
    ----------
    tolerance : width [the metric's unit] that the gauge is held against; None where there is none.
    tolerance_of : ``"study"``, ``"recipe"``, or empty where there is none.
    study : None where ``why`` says why there is none; ``anova`` and ``ranges`` are None then too.
    part : the balanced part that was taken of a crossing that is not whole; None where all was taken.
    missing : runs a whole crossing would have needed, or has too many of, in words.
    against : reference values; None where there are none of this metric.
    """

    series: Series
    tolerance: float | None
    tolerance_of: str
    study: Study | None
    anova: GaugeAnova | None
    ranges: GaugeRange | None
    why: str
    part: BalancedPart | None
    missing: tuple[str, ...]
    against: AgainstReferences | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Gauge:
    """What stored runs say of the gauge.

    Parameters
    ----------
    runs : that were chosen.
    simulated : whether any of them was.
    notes : of all metrics alike, in sentences.
    """

    request: GaugeRequest
    runs: tuple[RunLine, ...]
    metrics: tuple[MetricGauge, ...]
    simulated: bool
    notes: tuple[str, ...]

    def appraisers(self) -> tuple[str, ...]:
        """Names of the stations or operators, sorted."""
        return tuple(sorted({appraiser_of(line, self.request.appraiser) for line in self.runs}))

    def sensors(self) -> tuple[str, ...]:
        """Serial numbers, sorted."""
        return tuple(sorted({line.serial for line in self.runs}))


def gauge(request: GaugeRequest, *, database: str | None = None) -> Gauge:
    """Study a gauge on stored runs.

    Parameters
    ----------
    database : URL or path; None for ``CBSR_QA_DATABASE`` or the default.

    Raises
    ------
    RefusedError
        If the request is none, nothing stored fits it, or no metric can be studied (with what is missing).
    """
    request.check()
    with open_store(database_url(database), create=False) as store:
        lines, notes = chosen_runs(store, request)
        wanted = wanted_metrics(store, request, lines)
        notes += software_note(store.software_of(lines)) + recipe_note(store, lines)
        simulated = bool(store.identity(lines[-1].run).simulated)
    metrics = tuple(_metric(one, request) for one in wanted)
    _check_any(metrics)
    return Gauge(request, lines, metrics, simulated, notes)


def _metric(wanted: Toleranced, request: GaugeRequest) -> MetricGauge:
    series = wanted.series
    sensors = [line.serial for line in series.lines]
    appraisers = [appraiser_of(line, request.appraiser) for line in series.lines]
    against = against_references(series, appraisers, request.references)
    why = _never_repeated(sensors, appraisers, request.appraiser)
    missing = () if why else missing_runs(sensors, appraisers, request.appraiser)
    bare = MetricGauge(
        series, wanted.tolerance, wanted.of, None, None, None, why, None, missing, against, series.notes
    )
    if why:
        return bare
    values = list(series.values)
    if missing and request.largest_balanced:
        part = largest_balanced(sensors, appraisers)
        if not part.kept:
            crossed = f"twice each {on(request.appraiser)} the same two {request.appraiser}s"
            return replace(bare, part=part, why=f"no two sensors were run {crossed}: nothing is crossed")
        size = part.words(appraiser=f"{request.appraiser}s")
        taken = f"taken is the largest balanced part of {len(values)} runs: {size}"
        bare = replace(bare, part=part, notes=(*series.notes, taken))
        sensors, appraisers = [sensors[k] for k in part.kept], [appraisers[k] for k in part.kept]
        values = [values[k] for k in part.kept]
    try:
        found, anova, ranges = _studied(sensors, appraisers, values, wanted.tolerance, request)
    except NumericsError as error:
        return replace(bare, why=error.reason)
    return replace(bare, study=found, anova=anova, ranges=ranges)


def _never_repeated(sensors: Sequence[str], appraisers: Sequence[str], appraiser: str) -> str:
    """Say that no sensor was run twice by the same appraiser, which no choice of runs mends; empty where one was."""
    cells = Counter(zip(sensors, appraisers, strict=True))
    if not cells or max(cells.values()) > 1 or min(len(set(sensors)), len(set(appraisers))) < 2:
        return ""
    where = "on a station" if appraiser == "station" else f"by an {appraiser}"
    return f"every sensor was run once {where}: repeatability needs at least two runs of each"


def _studied(
    sensors: Sequence[str],
    appraisers: Sequence[str],
    values: Sequence[float],
    tolerance: float | None,
    request: GaugeRequest,
) -> tuple[Study, GaugeAnova, GaugeRange]:
    if not values:
        raise NumericsError("none of these runs has a value of it")
    for noun, names in (("sensor", set(sensors)), (request.appraiser, set(appraisers))):
        if len(names) < 2:
            raise NumericsError(f"all {len(values)} runs are of one {noun}, {names.pop()}")
    found = study(sensors, appraisers, values, appraiser=request.appraiser)
    return (
        found,
        gauge_anova(found, tolerance=tolerance, confidence=request.confidence),
        gauge_range(found, tolerance=tolerance),
    )


def _check_any(metrics: Sequence[MetricGauge]) -> None:
    """Refuse where nothing came of any metric, saying what is missing."""
    if any(one.study is not None or one.against is not None for one in metrics):
        return
    first = metrics[0]
    said = f"{first.series.key.label}: {first.why}"
    said += f"; uneven: {named(first.missing)}" if first.missing else ""
    said += "".join(f"; {note}" for note in first.series.notes)
    said += f"\nand of {plural(len(metrics) - 1, 'more metric')}" if len(metrics) > 1 else ""
    lacking = any(one.missing and one.part is None for one in metrics)
    raise RefusedError(
        f"no gauge study can be made of these runs: {said}",
        remedy="make them even, or take the largest balanced part by --largest-balanced"
        if lacking
        else "a study needs two sensors, on two stations (or by two operators), twice each, that differ",
    )
