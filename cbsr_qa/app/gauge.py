"""Gauge R&R from stored runs: sensors are the parts, stations or operators appraise, repeated runs are trials."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date
from difflib import get_close_matches
from typing import Any

from cbsr_qa.app.figure_series import Series, clock_notes, named, recipe_note, series_of, software_note
from cbsr_qa.app.gauge_document import gauge_document
from cbsr_qa.app.gauge_references import AgainstReferences, ReferenceValue, against_references
from cbsr_qa.config.echo import echo
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.run_figures import RunLine
from cbsr_qa.stats.gauge_anova import GaugeAnova, gauge_anova
from cbsr_qa.stats.gauge_balance import BalancedPart, largest_balanced, missing_runs
from cbsr_qa.stats.gauge_range import GaugeRange, gauge_range
from cbsr_qa.stats.gauge_study import Study, study
from cbsr_qa.store.figures import RunFilter
from cbsr_qa.store.repository import Repository, open_store

#: What may be an appraiser.
APPRAISERS = ("station", "operator")


@dataclass(frozen=True, slots=True)
class GaugeRequest:
    """What a study is of.

    Parameters
    ----------
    serials, recipe : which runs; at least one of them.
    since, until : first and last day the runs began on, UTC.
    metrics : names; none for those the recipe limits.
    by_location : one study a location instead of one of the mean over all.
    appraiser : ``"station"`` or ``"operator"``.
    largest_balanced : of a crossing that is not whole, take the largest part that is.
    references : what golden sensors truly are.
    """

    serials: tuple[str, ...] = ()
    recipe: str | None = None
    since: date | None = None
    until: date | None = None
    metrics: tuple[str, ...] = ()
    by_location: bool = False
    appraiser: str = "station"
    largest_balanced: bool = False
    references: tuple[ReferenceValue, ...] = ()
    confidence: float = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class MetricGauge:
    """One metric's study.

    Parameters
    ----------
    study : None where ``why`` says why there is none; ``anova`` and ``ranges`` are None then too.
    part : the balanced part that was taken of a crossing that is not whole; None where all was taken.
    missing : runs a whole crossing would have needed, in words.
    against : reference values; None where there are none of this metric.
    """

    series: Series
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

    def document(self) -> dict[str, Any]:
        """Return everything for ``--json``."""
        return gauge_document(self)


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
    if request.appraiser not in APPRAISERS:
        raise RefusedError(f"--appraiser is {echo(request.appraiser)}", remedy=f"allowed: {', '.join(APPRAISERS)}")
    if not 0 < request.confidence < 1:
        raise RefusedError(f"a confidence of {100 * request.confidence:g} % is none", remedy="allowed: 0 to 100 %")
    with open_store(database_url(database), create=False) as store:
        lines, notes = _chosen(store, request)
        figures = store.run_figures(lines, request.metrics, by_location=request.by_location)
        known = figures if figures or not request.metrics else store.run_figures(lines)
        notes += software_note(store.software_of(lines)) + recipe_note(store, lines)
        simulated = bool(store.identity(lines[-1].run).simulated)
    if request.by_location and figures:
        known = figures = tuple(figure for figure in figures if figure.key.location)
        if not figures:
            raise RefusedError(
                "these metrics are not of locations", remedy="leave out --by-location, or name a metric of locations"
            )
    metrics = tuple(_metric(series, request) for series in series_of(lines, known, request.metrics))
    if not metrics:
        raise RefusedError("none of these runs has measurements", remedy="choose runs that were finished")
    _check_any(metrics)
    _check_references(request, lines, metrics)
    return Gauge(request, lines, metrics, simulated, notes)


def appraiser_of(line: RunLine, kind: str) -> str:
    """Return who or what appraised a run: its station or its operator."""
    return line.station if kind == "station" else line.operator


def _chosen(store: Repository, request: GaugeRequest) -> tuple[tuple[RunLine, ...], tuple[str, ...]]:
    """The runs of the study, and what is to be said of them all."""
    if not request.serials and request.recipe is None:
        raise RefusedError("no study is named", remedy="choose runs by --serials S1,S2,… or --recipe R, or by both")
    lines = store.run_lines(RunFilter(serials=request.serials, recipe=request.recipe))
    lines = tuple(line for line in lines if _in_period(line, request))
    _check_found(store, request, lines)
    recipes = sorted({line.recipe for line in lines})
    if len(recipes) > 1:
        raise RefusedError(
            f"these runs are of {len(recipes)} recipes: {named(recipes)}", remedy="choose one by --recipe"
        )
    nobody = [line for line in lines if not appraiser_of(line, request.appraiser)]
    lines = tuple(line for line in lines if appraiser_of(line, request.appraiser))
    if not lines:
        raise RefusedError(f"none of these runs names its {request.appraiser}", remedy="study stations instead")
    notes = clock_notes(lines)
    if nobody:
        notes += (f"left out: {len(nobody)} runs that name no {request.appraiser}",)
    return lines, notes


def _in_period(line: RunLine, request: GaugeRequest) -> bool:
    day = line.started_at.astimezone(UTC).date()
    return (request.since is None or day >= request.since) and (request.until is None or day <= request.until)


def _check_found(store: Repository, request: GaugeRequest, lines: Sequence[RunLine]) -> None:
    missing = [serial for serial in request.serials if serial not in {line.serial for line in lines}]
    if lines and not missing:
        return
    stored = store.find_runs()
    for noun, wanted, known in (
        ("recipe", [request.recipe] if request.recipe else [], {run.recipe for run in stored}),
        ("sensor", missing, {run.serial for run in stored}),
    ):
        for name in wanted:
            if name not in known:
                near = get_close_matches(name, known, n=1)
                hint = f"did you mean {near[0]!r}?" if near else "cbsr-qa db status shows which database is used"
                raise RefusedError(f"no stored run is of {noun} {echo(name, 64)}", remedy=hint)
    if missing:
        raise RefusedError(
            f"sensor {named(missing)} has no analysed run that fits", remedy="choose other days or another recipe"
        )
    raise RefusedError("no analysed run fits this study", remedy="choose other days or another recipe")


def _metric(series: Series, request: GaugeRequest) -> MetricGauge:
    sensors = [line.serial for line in series.lines]
    appraisers = [appraiser_of(line, request.appraiser) for line in series.lines]
    against = against_references(series, appraisers, request.references)
    missing = missing_runs(sensors, appraisers)
    part, values, notes = None, list(series.values), list(series.notes)
    if missing and request.largest_balanced:
        part = largest_balanced(sensors, appraisers)
        notes.append(f"taken is the largest balanced part of {len(values)} runs: {part.words()}")
        sensors, appraisers = [sensors[k] for k in part.kept], [appraisers[k] for k in part.kept]
        values = [values[k] for k in part.kept]
    try:
        found, anova, ranges = _studied(sensors, appraisers, values, series.tolerance, request.confidence)
    except NumericsError as error:
        return MetricGauge(series, None, None, None, error.reason, part, missing, against, tuple(notes))
    return MetricGauge(series, found, anova, ranges, "", part, missing, against, tuple(notes))


def _studied(
    sensors: Sequence[str],
    appraisers: Sequence[str],
    values: Sequence[float],
    tolerance: float | None,
    confidence: float,
) -> tuple[Study, GaugeAnova, GaugeRange]:
    if not values:
        raise NumericsError("no sensors were run twice on two stations or by two operators each: nothing is crossed")
    for noun, names in (("sensor", set(sensors)), ("station or operator", set(appraisers))):
        if len(names) < 2:
            raise NumericsError(f"all {len(values)} runs are of one {noun}, {names.pop()}")
    found = study(sensors, appraisers, values)
    width = tolerance if tolerance and tolerance > 0 else None
    return found, gauge_anova(found, tolerance=width, confidence=confidence), gauge_range(found, tolerance=width)


def _check_any(metrics: Sequence[MetricGauge]) -> None:
    """Refuse where nothing came of any metric, saying what is missing."""
    if any(one.study is not None or one.against is not None for one in metrics):
        return
    first = metrics[0]
    said = f"{first.series.key.label}: {first.why}"
    said += f"; missing: {named(first.missing)}" if first.missing else ""
    said += f"\nand of {len(metrics) - 1} more metrics" if len(metrics) > 1 else ""
    lacking = any(one.missing and one.part is None for one in metrics)
    raise RefusedError(
        f"no gauge study can be made of these runs: {said}",
        remedy="add the missing runs, or take the largest balanced part by --largest-balanced"
        if lacking
        else "a study needs two sensors, on two stations (or by two operators), twice each, that differ",
    )


def _check_references(request: GaugeRequest, lines: Sequence[RunLine], metrics: Sequence[MetricGauge]) -> None:
    measured, serials = {one.series.key.name for one in metrics}, {line.serial for line in lines}
    for reference in request.references:
        if reference.metric not in measured:
            raise RefusedError(
                f"there is a reference value of {echo(reference.metric)}, which is not studied",
                remedy=f"studied: {', '.join(sorted(measured))}; name others by --metric",
            )
        if reference.serial not in serials:
            raise RefusedError(
                f"there is a reference value of sensor {echo(reference.serial, 64)}, which has no run in this study",
                remedy=f"sensors: {named(sorted(serials))}",
            )
