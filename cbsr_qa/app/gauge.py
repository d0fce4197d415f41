"""Gauge R&R from stored runs: sensors are the parts, stations or operators appraise, repeated runs are trials."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from cbsr_qa.app.figure_series import Series, named, recipe_note, software_note
from cbsr_qa.app.gauge_metrics import Toleranced, wanted_metrics
from cbsr_qa.app.gauge_references import AgainstReferences, against_references
from cbsr_qa.app.gauge_request import GaugeRequest
from cbsr_qa.app.gauge_runs import appraiser_of, chosen_runs
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.run_figures import RunLine
from cbsr_qa.report.numbers import plural
from cbsr_qa.stats.gauge_anova import GaugeAnova, gauge_anova
from cbsr_qa.stats.gauge_balance import BalancedPart, largest_balanced, missing_runs
from cbsr_qa.stats.gauge_range import GaugeRange, gauge_range
from cbsr_qa.stats.gauge_study import Study, on, study
from cbsr_qa.store.repository import open_store


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
