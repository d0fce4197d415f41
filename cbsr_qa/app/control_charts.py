"""Control charts of a station: a reference period chosen and stored, and the runs since held against it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from cbsr_qa.app.charting import standard_of
from cbsr_qa.app.charts_request import FEWEST_GROUPS, FEWEST_RUNS, ChartsRequest, ReferencePeriod, check_request
from cbsr_qa.app.charts_retired import held_references, retired
from cbsr_qa.app.charts_runs import charted_runs
from cbsr_qa.app.figure_series import Series, clock_notes, named, recipe_note, series_of, software_note
from cbsr_qa.app.metric_chart import MetricChart, metric_chart, no_chart
from cbsr_qa.clock import RealClock
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.naming import of_kind
from cbsr_qa.domain.run_figures import MetricKey, RunFigure, RunLine
from cbsr_qa.domain.station_charts import ChartReference, StandingSignal
from cbsr_qa.report.numbers import plural
from cbsr_qa.store.repository import Repository, open_store


@dataclass(frozen=True, slots=True, eq=False)
class Charts:
    """Charts of a station.

    Parameters
    ----------
    recipe : of the runs.
    stored : whether new references were stored.
    notes : of all charts alike.
    """

    request: ChartsRequest
    recipe: str
    runs: int
    charts: tuple[MetricChart, ...]
    stored: bool
    simulated: bool
    notes: tuple[str, ...]

    @property
    def signals(self) -> tuple[StandingSignal, ...]:
        """Those that stand."""
        return tuple(one.signal for one in self.charts if one.signal is not None)


def control_charts(request: ChartsRequest, *, database: str | None = None) -> Charts:
    """Chart a station's metrics, and store the reference period where a new one is given.

    Parameters
    ----------
    database : URL or path; None for ``CBSR_QA_DATABASE`` or the default.

    Raises
    ------
    RefusedError
        If the request is none, the station has no such runs, or there is nothing to chart; nothing is stored then.
    """
    check_request(request)
    with open_store(database_url(database), create=False) as store:
        lines, recipe = charted_runs(store, request)
        notes = (*clock_notes(lines), *filter(None, [store.from_the_future()]))
        notes += software_note(store.software_of(lines)) + recipe_note(store, lines)
        if request.period is not None and request.period.since is None:
            notes += (
                f"the reference period begins with the first run of all, of {lines[0].day}: see --reference-from",
            )
        ended = retired(store, request, recipe)
        notes += ended
        if ended and not held_references(store, request, recipe):
            charts: tuple[MetricChart, ...] = ()
        elif request.period is None:
            charts = _against_stored(store, request, recipe, lines)
        else:
            charts = _with_period(store, request, request.period, recipe, lines)
        new = [one.reference for one in charts if one.reference is not None] if request.period else []
        stored = bool(new) and request.period is not None and request.period.stored
        if stored:
            store.save_chart_references(new)
        simulated = bool(store.identity(lines[-1].run).simulated)
    return Charts(request, recipe, len(lines), charts, stored, simulated, notes)


def _against_stored(
    store: Repository, request: ChartsRequest, recipe: str, lines: Sequence[RunLine]
) -> tuple[MetricChart, ...]:
    found = held_references(store, request, recipe)
    lacking = [name for name in request.metrics if name not in {one.key.name for one in found}]
    if not found or lacking:
        of = f" for {named(lacking)}" if lacking else ""
        series_of(lines, store.run_figures(lines), request.metrics)  # a name that nobody measured is said first
        raise RefusedError(
            f"no reference period is stored{of} for recipe {recipe} on {of_kind('station', request.station)}",
            remedy="store one with --reference-runs N or --reference-until DATE, and --operator",
        )
    since = min(one.first_run for one in found)
    by_key: dict[MetricKey, list[RunFigure]] = {}
    for by_location in sorted({bool(one.key.location) for one in found}):
        names = sorted({one.key.name for one in found if bool(one.key.location) == by_location})
        for figure in store.run_figures([x for x in lines if x.run >= since], names, by_location=by_location):
            by_key.setdefault(figure.key, []).append(figure)
    charts: list[MetricChart] = []
    for one in found:
        own = [line for line in lines if line.run >= one.first_run]
        charts += [metric_chart(series, one) for series in series_of(own, by_key.get(one.key, ()), [one.key.name])]
    return tuple(charts)


def _with_period(
    store: Repository, request: ChartsRequest, period: ReferencePeriod, recipe: str, lines: Sequence[RunLine]
) -> tuple[MetricChart, ...]:
    """Charts with limits of a new reference period."""
    own = [line for line in lines if period.since is None or line.day >= period.since]
    if not own:
        here = of_kind("station", request.station)
        raise RefusedError(f"{here} has no run since {period.since}", remedy="begin earlier")
    figures = store.run_figures(own, request.metrics, by_location=request.by_location)
    if request.by_location:
        figures = tuple(figure for figure in figures if figure.key.location)
    known = figures or store.run_figures(own)
    charts = [_new_chart(store, series, request, period, recipe) for series in series_of(own, known, request.metrics)]
    if not charts:
        raise RefusedError("none of these runs has measurements", remedy="choose runs that were finished")
    if all(one.reference is None for one in charts):
        said = "\n".join("; ".join((f"  {one.label}: {one.why}", *one.notes)) for one in charts[:10])
        raise RefusedError(
            f"no limits come of this reference period:\n{said}", remedy="choose another or a longer one"
        )
    return tuple(charts)


def _new_chart(
    store: Repository, series: Series, request: ChartsRequest, period: ReferencePeriod, recipe: str
) -> MetricChart:
    count = _period_runs(series.lines, period)
    if count < FEWEST_RUNS or (period.runs is not None and len(series.lines) < period.runs):
        wanted = period.runs or FEWEST_RUNS
        return no_chart(series, f"{plural(count, 'run')} in the reference period instead of {wanted}")
    size = request.settings.subgroup
    rest = count % size
    if size > 1 and count < FEWEST_GROUPS * size:
        groups = plural(count // size, "whole group")
        return no_chart(
            series, f"{count} runs in the reference period make {groups} of {size} instead of {FEWEST_GROUPS}"
        )
    if rest:
        left = (
            f"the last {plural(rest, 'run')} of the reference period make no whole group of {size}: taken as after it"
        )
        count, series = count - rest, replace(series, notes=(*series.notes, left))
    try:
        standard = standard_of(series.values[:count], request.settings)
    except NumericsError as error:
        return no_chart(series, error.reason)
    reference = ChartReference(
        reference=store.new_id(),
        station=request.station,
        recipe=recipe,
        golden=request.golden,
        key=series.key,
        unit=series.unit,
        settings=request.settings,
        mean=standard.mean,
        deviation=standard.deviation,
        runs=count,
        first_run=series.lines[0].run,
        last_run=series.lines[count - 1].run,
        operator=period.operator,
        made_at=RealClock().wall(),
        why=period.why,
    )
    return metric_chart(series, reference)


def _period_runs(lines: Sequence[RunLine], period: ReferencePeriod) -> int:
    """How many runs belong to the period: those before the first one that began after its last day."""
    if period.runs is not None:
        return min(period.runs, len(lines))
    assert period.until is not None
    later = (number for number, line in enumerate(lines) if line.day > period.until)
    return next(later, len(lines))
