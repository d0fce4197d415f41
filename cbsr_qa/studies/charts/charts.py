"""Control charts of a station: a reference period chosen and stored, and later runs compared with it.

A changed reference is a new row of the store, and so is a retirement, after which its limits are no longer used.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Final

from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.numbers import prefix_kind
from cbsr_qa.domain.results.charts import ChartReference, StandingSignal
from cbsr_qa.domain.results.fleet import FleetTable, RunLine, RunSelection
from cbsr_qa.report.tables import list_names, plural
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.studies.charts.charting import MetricChart, metric_chart, reference_figures, refuse_chart, standard_of
from cbsr_qa.studies.charts.request import FEWEST_GROUPS, FEWEST_RUNS, ChartsRequest, ReferencePeriod, check_request
from cbsr_qa.studies.figure_series import Series, figures_of, series_of
from cbsr_qa.studies.selection import check_names, clock_notes, describe_recipes, likeness_notes, nearest
from cbsr_qa.system.clock import RealClock
from cbsr_qa.system.words import echo

# Notes on all charts, and reasons why a metric has none.
_FROM_FIRST: Final = (
    "the reference period begins with the station's first run ({day}); --reference-from chooses another day"
)
_RETIRED: Final = "retired by {operator}: {charts}; a new reference starts them again"
_SHORT: Final = "{runs} in the reference period instead of {wanted}"
_FEW_GROUPS: Final = "{runs} runs in the reference period make {groups} of {size} instead of {least}"
_LEFT: Final = "the last {runs} of the reference period do not fill a group of {size}: taken as after it"


@dataclass(frozen=True, slots=True, eq=False)
class Charts:
    """Charts of a station's production runs, or of one golden sensor.

    Parameters
    ----------
    stored : whether new references were stored.
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
        return tuple(chart.signal for chart in self.charts if chart.signal is not None)


def control_charts(request: ChartsRequest, *, database: str | None = None) -> Charts:
    """Chart a station's metrics, and store the reference period if a new one is given.

    Raises
    ------
    RefusedError
        If the request contradicts itself, the station has no such runs, or there is nothing to chart; nothing is
        stored then.
    """
    check_request(request)
    period = request.period
    with open_store(database_url(database), create=False) as store:
        table = store.fleet.load_table(_select_runs(store, request))
        lines = tuple(run for run in table.runs if run.outcome is not None)
        recipe = lines[0].recipe
        notes = (*clock_notes(lines), *filter(None, [store.describe_clock_fault()]), *likeness_notes(store, lines))
        if period is not None:
            notes += () if period.since else (_FROM_FIRST.format(day=lines[0].day),)
            charts = _with_period(store, request, period, table, lines)
        else:
            references = _select_references(store, request, recipe)
            if request.retire is not None:
                notes += (_retire(store, request, references),)
                references = _select_references(store, request, recipe)
            all_retired = request.retire is not None and not references
            charts = () if all_retired else _chart_against_stored(table, request, recipe, lines, references)
        stored = period is not None and not request.dry_run
        if stored:
            store.charts.save([chart.reference for chart in charts if chart.reference is not None])
    in_control = all(chart.signal is None for chart in charts)
    golden = request.golden
    simulated = bool(lines[-1].simulated)
    return Charts(request.station, recipe, golden, len(lines), in_control, stored, simulated, notes, charts)


def _select_runs(store: Repository, request: ChartsRequest) -> RunSelection:
    """Return the charted runs, of one recipe; refuse if there are none, or several recipes."""
    golden, station = request.golden, prefix_kind("station", request.station)
    selection = RunSelection(
        serials=(golden,) if golden else (),
        stations=(request.station,),
        checks=bool(golden),
        recipe=request.recipe,
        parts=request.parts,
    )
    recipes = {run.recipe for run in store.fleet.read_lines(selection) if run.outcome is not None}
    if len(recipes) == 1:
        return replace(selection, recipe=recipes.pop())
    if recipes:
        raise RefusedError(f"{station} ran {describe_recipes(recipes)}", remedy="choose one by --recipe")
    check_names(store, replace(selection, serials=()))
    recipes_run = {
        run.recipe for run in store.fleet.read_lines(replace(selection, recipe=None)) if run.outcome is not None
    }
    if recipes_run and request.recipe is not None:
        raise RefusedError(
            f"{station} has no runs of recipe {echo(request.recipe, 64)}",
            remedy=nearest(request.recipe, recipes_run, "it ran"),
        )
    origin = f"of sensor {echo(golden, 64)}" if golden else "of production"
    raise RefusedError(
        f"{station} has no analysed run {origin}", remedy="golden sensors are charted by --golden SERIAL"
    )


def _select_references(store: Repository, request: ChartsRequest, recipe: str) -> list[ChartReference]:
    """Return the valid references of the requested charts."""
    return [
        reference
        for reference in store.charts.read_current(request.station)
        if (reference.recipe, reference.golden) == (recipe, request.golden)
        and (not request.metrics or reference.name in request.metrics)
    ]


def _retire(store: Repository, request: ChartsRequest, held: Sequence[ChartReference]) -> str:
    """Retire the charts of one kind, for the named metrics or all; return a note with their names."""
    retired_at, operator, why = RealClock().wall(), request.operator, request.why
    rows = [
        replace(reference, reference=store.new_id(), operator=operator, made_at=retired_at, why=why, retired=True)
        for reference in held
        if reference.chart is request.retire
    ]
    if not rows:
        kinds = ", ".join(sorted({str(reference.chart) for reference in held}))
        raise RefusedError(
            f"no chart {request.retire} of these metrics holds on this station",
            remedy=f"charts that hold are {kinds}" if kinds else "this station has no charts",
        )
    store.charts.save(rows)
    return _RETIRED.format(operator=operator, charts=list_names([row.label for row in rows]))


def _chart_against_stored(
    table: FleetTable, request: ChartsRequest, recipe: str, lines: Sequence[RunLine], held: Sequence[ChartReference]
) -> tuple[MetricChart, ...]:
    lacking = [name for name in request.metrics if name not in {reference.name for reference in held}]
    if not held or lacking:
        clause = f" for {list_names(lacking)}" if lacking else ""
        series_of(lines, figures_of(table), request.metrics)  # a metric that was never measured is refused first
        raise RefusedError(
            f"no reference period is stored{clause} for recipe {recipe} on {prefix_kind('station', request.station)}",
            remedy="store one with --reference-runs N or --reference-until DATE, and --operator",
        )
    figures = reference_figures(table, held)
    charts: list[MetricChart] = []
    for reference in held:
        later_lines = [line for line in lines if line.run >= reference.first_run]
        members = series_of(later_lines, {reference.key: figures.get(reference.key, {})}, [reference.name])
        charts += [metric_chart(series, reference) for series in members]
    return tuple(charts)


def _with_period(
    store: Repository, request: ChartsRequest, period: ReferencePeriod, table: FleetTable, lines: Sequence[RunLine]
) -> tuple[MetricChart, ...]:
    period_lines = [line for line in lines if period.since is None or line.day >= period.since]
    if not period_lines:
        station = prefix_kind("station", request.station)
        raise RefusedError(f"{station} has no run since {period.since}", remedy="begin earlier")
    figures = figures_of(table, by_location=request.by_location)
    if request.by_location:
        names = request.metrics or {key.name for key in figures}
        of_locations = {
            key: key_figures for key, key_figures in figures.items() if key.location and key.name in names
        }
        figures = of_locations or figures_of(table)
    series = series_of(period_lines, figures, request.metrics)
    charts = tuple(_new_chart(store, member, request, period, period_lines[0].recipe) for member in series)
    if not charts:
        raise RefusedError("none of these runs has measurements", remedy="choose runs that were finished")
    if all(chart.reference is None for chart in charts):
        reasons = "\n".join("; ".join((f"  {member.label}: {member.why}", *member.notes)) for member in charts[:10])
        raise RefusedError(
            f"this reference period gives no limits:\n{reasons}", remedy="choose another or a longer one"
        )
    return charts


def _new_chart(
    store: Repository, series: Series, request: ChartsRequest, period: ReferencePeriod, recipe: str
) -> MetricChart:
    count, size = _period_runs(series.lines, period), request.settings.subgroup
    if count < FEWEST_RUNS or (period.runs is not None and len(series.lines) < period.runs):
        return refuse_chart(series, _SHORT.format(runs=plural(count, "run"), wanted=period.runs or FEWEST_RUNS))
    if size > 1 and count < FEWEST_GROUPS * size:
        groups = plural(count // size, "whole group")
        return refuse_chart(series, _FEW_GROUPS.format(runs=count, groups=groups, size=size, least=FEWEST_GROUPS))
    if ungrouped_count := count % size:
        note = _LEFT.format(runs=plural(ungrouped_count, "run"), size=size)
        count, series = count - ungrouped_count, replace(series, notes=(*series.notes, note))
    try:
        standard = standard_of(series.values[:count], request.settings)
    except NumericsError as error:
        return refuse_chart(series, error.reason)
    reference = fill_from_object(
        ChartReference,
        request,
        **asdict(request.settings),
        **asdict(series.key),
        reference=store.new_id(),
        recipe=recipe,
        unit=series.unit,
        mean=standard.mean,
        deviation=standard.deviation,
        runs=count,
        first_run=series.lines[0].run,
        last_run=series.lines[count - 1].run,
        made_at=RealClock().wall(),
    )
    return metric_chart(series, reference)


def _period_runs(lines: Sequence[RunLine], period: ReferencePeriod) -> int:
    """Number of runs in the period: those before the first one that began after its last day."""
    if period.runs is not None:
        return min(period.runs, len(lines))
    assert period.until is not None
    later = (number for number, line in enumerate(lines) if line.day > period.until)
    return next(later, len(lines))
