"""Control charts of a station: a reference period chosen and stored, and the runs since held against it.

A changed reference is a new row of the store. So is a retirement: nothing is charted against its limits any more.
"""

from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, replace
from typing import Final

from cbsr_qa.config import database_url
from cbsr_qa.domain import NumericsError, RefusedError, did_you_mean, of_kind
from cbsr_qa.domain.results import RunLine
from cbsr_qa.domain.run import ChartReference, StandingSignal
from cbsr_qa.plugin import echo
from cbsr_qa.report import named, plural
from cbsr_qa.store import Repository, RunFilter, open_store
from cbsr_qa.studies.charts.charting import MetricChart, metric_chart, no_chart, reference_figures, standard_of
from cbsr_qa.studies.charts.request import FEWEST_GROUPS, FEWEST_RUNS, ChartsRequest, ReferencePeriod, check_request
from cbsr_qa.studies.figure_series import Series, clock_notes, recipe_note, series_of, software_note
from cbsr_qa.system import RealClock

# What is noted of all charts, or why a metric has none.
_FROM_FIRST: Final = "the reference period begins with the first run of all, of {day}: see --reference-from"
_RETIRED: Final = "retired by {operator}: {charts}; a new reference begins them anew"
_SHORT: Final = "{runs} in the reference period instead of {wanted}"
_FEW_GROUPS: Final = "{runs} runs in the reference period make {groups} of {size} instead of {least}"
_LEFT: Final = "the last {runs} of the reference period do not fill a group of {size}: taken as after it"


@dataclass(frozen=True, slots=True, eq=False)
class Charts:
    """Charts of a station.

    Parameters
    ----------
    golden : sensor that is charted; None for production runs.
    in_control : whether no signal stands.
    stored : whether new references were stored.
    notes : of all charts alike.
    """

    station: str
    recipe: str
    golden: str | None
    runs: int
    in_control: bool
    stored: bool
    simulated: bool
    notes: tuple[str, ...]
    charts: tuple[MetricChart, ...]

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
        If the request contradicts itself, the station has no such runs, or there is nothing to chart; nothing is
        stored then.
    """
    check_request(request)
    period = request.period
    with open_store(database_url(database), create=False) as store:
        lines, recipe = _charted_runs(store, request)
        notes = (*clock_notes(lines), *filter(None, [store.from_the_future()]))
        notes += software_note(store.software_of(lines)) + recipe_note(store, lines)
        if period is not None:
            notes += () if period.since else (_FROM_FIRST.format(day=lines[0].day),)
            charts = _with_period(store, request, period, recipe, lines)
        else:
            held = _held_references(store, request, recipe)
            if request.retire is not None:
                notes += (_retired(store, request, held),)
                held = _held_references(store, request, recipe)
            empty = request.retire is not None and not held
            charts = () if empty else _against_stored(store, request, recipe, lines, held)
        stored = period is not None and not request.dry_run
        if stored:
            store.save_chart_references([one.reference for one in charts if one.reference is not None])
        simulated = bool(store.identity(lines[-1].run).simulated)
    in_control = all(one.signal is None for one in charts)
    golden = request.golden
    return Charts(request.station, recipe, golden, len(lines), in_control, stored, simulated, notes, charts)


def _charted_runs(store: Repository, request: ChartsRequest) -> tuple[tuple[RunLine, ...], str]:
    """Return the runs of the station that are charted, and their recipe; refuse none, or those of several recipes."""
    golden, here = request.golden, of_kind("station", request.station)
    wanted = RunFilter(serials=(golden,) if golden else (), station=request.station, golden=bool(golden))
    lines = store.run_lines(wanted)
    recipes = sorted({line.recipe for line in lines})
    recipe = request.recipe or (recipes[0] if len(recipes) == 1 else "")
    if recipe in recipes:
        return tuple(line for line in lines if line.recipe == recipe), recipe
    stations = sorted({run.station for run in store.find_runs()})
    if request.station not in stations:
        hint = did_you_mean(request.station, stations, f"stored: {named(stations) or 'no runs at all'}")
        raise RefusedError(f"no run of station {echo(request.station, 64)} is stored", remedy=hint)
    if not lines:
        of = f"of sensor {echo(golden, 64)}" if golden else "of production"
        remedy = "golden sensors are charted by --golden SERIAL"
        raise RefusedError(f"{here} has no analysed run {of}", remedy=remedy)
    if not recipe:
        raise RefusedError(f"{here} ran {len(recipes)} recipes: {named(recipes)}", remedy="choose one by --recipe")
    hint = did_you_mean(recipe, recipes, f"it ran: {named(recipes)}")
    raise RefusedError(f"{here} has no runs of recipe {echo(recipe, 64)}", remedy=hint)


def _held_references(store: Repository, request: ChartsRequest, recipe: str) -> list[ChartReference]:
    """Return the references that hold of the charts that are asked for."""
    return [
        one
        for one in store.chart_references(request.station)
        if (one.recipe, one.golden) == (recipe, request.golden)
        and (not request.metrics or one.name in request.metrics)
    ]


def _retired(store: Repository, request: ChartsRequest, held: Sequence[ChartReference]) -> str:
    """Retire the charts of one kind, of the metrics that are named or of all; return a note that names them."""
    now, by, why = RealClock().wall(), request.operator, request.why
    rows = [
        replace(one, reference=store.new_id(), operator=by, made_at=now, why=why, retired=True)
        for one in held
        if one.chart is request.retire
    ]
    if not rows:
        kinds = ", ".join(sorted({str(one.chart) for one in held}))
        raise RefusedError(
            f"no chart {request.retire} of these metrics holds on this station",
            remedy=f"charts that hold are {kinds}" if kinds else "this station has no charts",
        )
    store.save_chart_references(rows)
    return _RETIRED.format(operator=by, charts=named([one.label for one in rows]))


def _against_stored(
    store: Repository,
    request: ChartsRequest,
    recipe: str,
    lines: Sequence[RunLine],
    held: Sequence[ChartReference],
) -> tuple[MetricChart, ...]:
    lacking = [name for name in request.metrics if name not in {one.name for one in held}]
    if not held or lacking:
        of = f" for {named(lacking)}" if lacking else ""
        series_of(lines, store.run_figures(lines), request.metrics)  # a name that nobody measured is said first
        raise RefusedError(
            f"no reference period is stored{of} for recipe {recipe} on {of_kind('station', request.station)}",
            remedy="store one with --reference-runs N or --reference-until DATE, and --operator",
        )
    since = [line for line in lines if line.run >= min(one.first_run for one in held)]
    figures = reference_figures(store, since, held)
    charts: list[MetricChart] = []
    for one in held:
        own = [line for line in since if line.run >= one.first_run]
        found = series_of(own, figures.get(one.key, {}).values(), [one.name])
        charts += [metric_chart(series, one) for series in found]
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
    series = series_of(own, figures or store.run_figures(own), request.metrics)
    charts = tuple(_new_chart(store, one, request, period, recipe) for one in series)
    if not charts:
        raise RefusedError("none of these runs has measurements", remedy="choose runs that were finished")
    if all(one.reference is None for one in charts):
        said = "\n".join("; ".join((f"  {one.label}: {one.why}", *one.notes)) for one in charts[:10])
        raise RefusedError(
            f"no limits come of this reference period:\n{said}", remedy="choose another or a longer one"
        )
    return charts


def _new_chart(
    store: Repository, series: Series, request: ChartsRequest, period: ReferencePeriod, recipe: str
) -> MetricChart:
    count, size = _period_runs(series.lines, period), request.settings.subgroup
    if count < FEWEST_RUNS or (period.runs is not None and len(series.lines) < period.runs):
        return no_chart(series, _SHORT.format(runs=plural(count, "run"), wanted=period.runs or FEWEST_RUNS))
    if size > 1 and count < FEWEST_GROUPS * size:
        groups = plural(count // size, "whole group")
        return no_chart(series, _FEW_GROUPS.format(runs=count, groups=groups, size=size, least=FEWEST_GROUPS))
    if rest := count % size:
        left = _LEFT.format(runs=plural(rest, "run"), size=size)
        count, series = count - rest, replace(series, notes=(*series.notes, left))
    try:
        standard = standard_of(series.values[:count], request.settings)
    except NumericsError as error:
        return no_chart(series, error.reason)
    reference = ChartReference(
        *astuple(request.settings),
        reference=store.new_id(),
        station=request.station,
        recipe=recipe,
        golden=request.golden,
        **asdict(series.key),
        unit=series.unit,
        mean=standard.mean,
        deviation=standard.deviation,
        runs=count,
        first_run=series.lines[0].run,
        last_run=series.lines[count - 1].run,
        operator=request.operator,
        made_at=RealClock().wall(),
        why=request.why,
    )
    return metric_chart(series, reference)


def _period_runs(lines: Sequence[RunLine], period: ReferencePeriod) -> int:
    """How many runs belong to the period: those before the first one that began after its last day."""
    if period.runs is not None:
        return min(period.runs, len(lines))
    assert period.until is not None
    later = (number for number, line in enumerate(lines) if line.day > period.until)
    return next(later, len(lines))
