"""Control charts of a station: a reference period chosen and stored, and the runs since held against it.

The runs of a station that are charted, and what is said where there are none.

Retiring charts of a station: a row more, which says that nothing is charted against their limits from here on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches

from cbsr_qa.config import database_url, echo
from cbsr_qa.domain import NumericsError, RefusedError, of_kind
from cbsr_qa.domain.results import MetricKey, RunFigure, RunLine
from cbsr_qa.domain.run import ChartReference, StandingSignal
from cbsr_qa.report import plural
from cbsr_qa.store import Repository, RunFilter, open_store
from cbsr_qa.studies.charts.charting import MetricChart, metric_chart, no_chart, standard_of
from cbsr_qa.studies.charts.request import FEWEST_GROUPS, FEWEST_RUNS, ChartsRequest, ReferencePeriod, check_request
from cbsr_qa.studies.figure_series import Series, clock_notes, named, recipe_note, series_of, software_note
from cbsr_qa.system import RealClock


def charted_runs(store: Repository, request: ChartsRequest) -> tuple[tuple[RunLine, ...], str]:
    """Return the runs of the station that are charted, and their recipe.

    Raises
    ------
    RefusedError
        If there are none, or they are of several recipes.
    """
    wanted = RunFilter(
        serials=(request.golden,) if request.golden else (),
        station=request.station,
        golden=bool(request.golden),
    )
    lines = store.run_lines(wanted)
    if not lines:
        raise _nothing(store, request)
    here = of_kind("station", request.station)
    recipes = sorted({line.recipe for line in lines})
    if request.recipe is None and len(recipes) > 1:
        raise RefusedError(f"{here} ran {len(recipes)} recipes: {named(recipes)}", remedy="choose one by --recipe")
    recipe = request.recipe or recipes[0]
    if recipe not in recipes:
        near = get_close_matches(recipe, recipes, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise RefusedError(
            f"{here} has no runs of recipe {echo(recipe, 64)}",
            remedy=f"{hint}it ran: {named(recipes)}",
        )
    return tuple(line for line in lines if line.recipe == recipe), recipe


def _nothing(store: Repository, request: ChartsRequest) -> RefusedError:
    stations = sorted({run.station for run in store.find_runs()})
    if request.station not in stations:
        near = get_close_matches(request.station, stations, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"stored: {named(stations) or 'no runs at all'}"
        return RefusedError(f"no run of station {echo(request.station, 64)} is stored", remedy=hint)
    of = f"of sensor {echo(request.golden, 64)}" if request.golden else "of production"
    return RefusedError(
        f"{of_kind('station', request.station)} has no analysed run {of}",
        remedy="golden sensors are charted by --golden SERIAL",
    )


def held_references(store: Repository, request: ChartsRequest, recipe: str) -> list[ChartReference]:
    """Return the references that hold of the charts that are asked for."""
    return [
        one
        for one in store.chart_references(request.station)
        if (one.recipe, one.golden) == (recipe, request.golden)
        and (not request.metrics or one.key.name in request.metrics)
    ]


def retired(store: Repository, request: ChartsRequest, recipe: str) -> tuple[str, ...]:
    """Retire the charts of one kind, of the metrics that are named or of all; return a note that names them.

    Raises
    ------
    RefusedError
        If no such chart holds.
    """
    ending = request.retirement
    if ending is None:
        return ()
    held = held_references(store, request, recipe)
    own = [one for one in held if one.settings.kind is ending.kind]
    if not own:
        kinds = ", ".join(sorted({str(one.settings.kind) for one in held}))
        raise RefusedError(
            f"no chart {ending.kind} of these metrics holds on this station",
            remedy=f"charts that hold are {kinds}" if kinds else "there is none at all",
        )
    rows = [_ended(store, one, ending.operator, ending.why) for one in own]
    store.save_chart_references(rows)
    return (_note(rows),)


def _ended(store: Repository, one: ChartReference, operator: str, why: str) -> ChartReference:
    return replace(
        one, reference=store.new_id(), operator=operator, made_at=RealClock().wall(), why=why, retired=True
    )


def _note(rows: Sequence[ChartReference]) -> str:
    return f"retired by {rows[0].operator}: {named([one.label for one in rows])}; a new reference begins them anew"


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
