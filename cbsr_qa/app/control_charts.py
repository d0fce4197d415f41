"""Control charts of a station: a reference period chosen and stored, and the runs since held against it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date
from difflib import get_close_matches
from typing import Any, Final

from cbsr_qa.app.charting import RULES, Charted, charts_of, standard_of, standing
from cbsr_qa.app.charts_document import charts_document
from cbsr_qa.app.figure_series import Series, clock_notes, named, recipe_note, series_of, software_note
from cbsr_qa.clock import RealClock
from cbsr_qa.config.echo import echo
from cbsr_qa.config.paths import database_url
from cbsr_qa.config.serials import validate_operator
from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.run_figures import MetricKey, RunFigure, RunLine
from cbsr_qa.domain.station_charts import ChartKind, ChartReference, ChartSettings, StandingSignal
from cbsr_qa.stats.control_charts import Standard
from cbsr_qa.stats.range_constants import MOST
from cbsr_qa.store.figures import RunFilter
from cbsr_qa.store.repository import Repository, open_store

#: Fewer runs make limits that are next to none; below the second number it is said how wide they may be off.
FEWEST_RUNS: Final = 8
FEW_RUNS: Final = 25
_DEFAULT: Final = ChartSettings()


@dataclass(frozen=True, slots=True)
class ReferencePeriod:
    """A reference period that is to be stored.

    Parameters
    ----------
    since : first day, UTC; None for the first run there is.
    runs, until : so many runs, or all to the end of this day; one of them.
    operator, why : who sets it, and for what reason.
    stored : False shows what it would give and stores nothing.
    """

    since: date | None
    runs: int | None
    until: date | None
    operator: str
    why: str = ""
    stored: bool = True


@dataclass(frozen=True, slots=True)
class ChartsRequest:
    """Which charts.

    Parameters
    ----------
    recipe : of the runs; None where the station's are of one.
    golden : only runs of this sensor; empty for production runs.
    metrics : names; none for all with a stored reference, or (with a new period) those the recipe limits.
    by_location : a chart a location.
    period : to be set; None to chart against what is stored.
    """

    station: str
    recipe: str | None = None
    golden: str = ""
    metrics: tuple[str, ...] = ()
    by_location: bool = False
    settings: ChartSettings = _DEFAULT
    period: ReferencePeriod | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MetricChart:
    """One metric's charts.

    Parameters
    ----------
    reference : what its limits rest on; None where ``why`` says why there are none.
    lines, values : from the reference's first run on.
    phase_1 : how many of them are the reference's.
    before, after : charts of the reference period and of the runs since, which have the same limits.
    signal : that stands at the latest run.
    """

    label: str
    unit: str
    reference: ChartReference | None
    lines: tuple[RunLine, ...]
    values: tuple[float, ...]
    phase_1: int
    before: tuple[Charted, ...]
    after: tuple[Charted, ...]
    signal: StandingSignal | None
    why: str
    notes: tuple[str, ...]


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

    def document(self) -> dict[str, Any]:
        """Return everything for ``--json``."""
        return charts_document(self)


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
    _check(request)
    with open_store(database_url(database), create=False) as store:
        lines, recipe = _runs(store, request)
        notes = (*clock_notes(lines), *filter(None, [store.from_the_future()]))
        notes += software_note(store.software_of(lines)) + recipe_note(store, lines)
        if request.period is None:
            charts = _against_stored(store, request, recipe, lines)
        else:
            charts = _with_period(store, request, request.period, recipe, lines)
        new = [one.reference for one in charts if one.reference is not None] if request.period else []
        stored = bool(new) and request.period is not None and request.period.stored
        if stored:
            store.save_chart_references(new)
        simulated = bool(store.identity(lines[-1].run).simulated)
    return Charts(request, recipe, len(lines), charts, stored, simulated, notes)


def _check(request: ChartsRequest) -> None:
    settings, period = request.settings, request.period
    unknown = [str(number) for number in settings.rules if number not in RULES]
    if unknown or not settings.rules:
        raise RefusedError(f"--rules names {', '.join(unknown) or 'none'}", remedy="allowed: 1 to 8, Nelson's tests")
    grouped = settings.kind is ChartKind.MEANS
    if not (2 <= settings.subgroup <= MOST if grouped else settings.subgroup == 1):
        allowed = f"2 to {MOST} with --chart xbar-r, and none with another chart"
        raise RefusedError(f"--subgroup is {settings.subgroup}", remedy=f"allowed: {allowed}")
    if period is None:
        return
    if (period.runs is None) == (period.until is None):
        raise RefusedError(
            "the reference period has no end, or two", remedy="give --reference-runs N or --reference-until DATE"
        )
    if period.runs is not None and period.runs < FEWEST_RUNS:
        raise RefusedError(f"a reference period of {period.runs} runs is too short", remedy=f"at least {FEWEST_RUNS}")
    validate_operator(period.operator)
    if period.stored and not period.operator:
        raise RefusedError(
            "nobody sets this reference", remedy="give --operator: who sets limits is kept with them (or --dry-run)"
        )


def _runs(store: Repository, request: ChartsRequest) -> tuple[tuple[RunLine, ...], str]:
    """The runs of the station that are charted, and their recipe."""
    wanted = RunFilter(
        serials=(request.golden,) if request.golden else (),
        station=request.station,
        golden=bool(request.golden),
    )
    lines = store.run_lines(wanted)
    if not lines:
        raise _nothing(store, request)
    recipes = sorted({line.recipe for line in lines})
    if request.recipe is None and len(recipes) > 1:
        raise RefusedError(
            f"station {request.station} ran {len(recipes)} recipes: {named(recipes)}", remedy="choose one by --recipe"
        )
    recipe = request.recipe or recipes[0]
    if recipe not in recipes:
        near = get_close_matches(recipe, recipes, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise RefusedError(
            f"station {request.station} has no runs of recipe {echo(recipe, 64)}",
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
        f"station {request.station} has no analysed run {of}", remedy="golden sensors are charted by --golden SERIAL"
    )


def _against_stored(
    store: Repository, request: ChartsRequest, recipe: str, lines: Sequence[RunLine]
) -> tuple[MetricChart, ...]:
    found = [
        one
        for one in store.chart_references(request.station)
        if (one.recipe, one.golden) == (recipe, request.golden)
        and (not request.metrics or one.key.name in request.metrics)
    ]
    lacking = [name for name in request.metrics if name not in {one.key.name for one in found}]
    if not found or lacking:
        of = f" for {named(lacking)}" if lacking else ""
        series_of(lines, store.run_figures(lines), request.metrics)  # a name that nobody measured is said first
        raise RefusedError(
            f"no reference period is stored{of} for recipe {recipe} on station {request.station}",
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
        charts += [_chart(series, one) for series in series_of(own, by_key.get(one.key, ()), [one.key.name])]
    return tuple(charts)


def _with_period(
    store: Repository, request: ChartsRequest, period: ReferencePeriod, recipe: str, lines: Sequence[RunLine]
) -> tuple[MetricChart, ...]:
    """Charts with limits of a new reference period."""
    own = [line for line in lines if period.since is None or _day(line) >= period.since]
    if not own:
        raise RefusedError(f"station {request.station} has no run since {period.since}", remedy="begin earlier")
    figures = store.run_figures(own, request.metrics, by_location=request.by_location)
    if request.by_location:
        figures = tuple(figure for figure in figures if figure.key.location)
    known = figures or store.run_figures(own)
    charts = [_new_chart(store, series, request, period, recipe) for series in series_of(own, known, request.metrics)]
    if all(one.reference is None for one in charts):
        said = "\n".join(f"  {one.label}: {one.why}" for one in charts[:10])
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
        return _none(series, f"{len(series.lines[:count])} runs in the reference period instead of {wanted}")
    try:
        standard = standard_of(series.values[:count], request.settings, series.key.label)
    except NumericsError as error:
        return _none(series, error.reason)
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
    return _chart(series, reference)


def _period_runs(lines: Sequence[RunLine], period: ReferencePeriod) -> int:
    """How many runs belong to the period: those before the first one that began after its last day."""
    if period.runs is not None:
        return min(period.runs, len(lines))
    assert period.until is not None
    later = (number for number, line in enumerate(lines) if _day(line) > period.until)
    return next(later, len(lines))


def _none(series: Series, why: str) -> MetricChart:
    return MetricChart(
        series.key.label, series.unit, None, series.lines, series.values, 0, (), (), None, why, series.notes
    )


def _chart(series: Series, reference: ChartReference) -> MetricChart:
    notes = list(series.notes)
    if series.unit != reference.unit:
        return replace(_none(series, f"runs are in {series.unit}, the reference in {reference.unit}"))
    count = sum(line.run <= reference.last_run for line in series.lines)
    standard = Standard(reference.mean, reference.deviation)
    before = _charts(series.values[:count], reference.settings, standard)
    after = _charts(series.values[count:], reference.settings, standard)
    if reference.runs < FEW_RUNS:
        notes.append(f"limits of {reference.runs} runs are uncertain: false alarms may be several times as many")
    doubtful = dict.fromkeys(signal.rule for one in before for signal in one.chart.signals)
    if doubtful:
        notes.append(
            f"the reference period gives signals itself, so that its limits are doubtful: {named(list(doubtful))}"
        )
    if count != reference.runs:
        notes.append(
            f"{count} of the {reference.runs} runs of the reference have a value now: some were analysed anew"
        )
    signal = standing(after, series.lines[count:], reference, cut=False)
    return MetricChart(
        reference.label,
        series.unit,
        reference,
        series.lines,
        series.values,
        count,
        before,
        after,
        signal,
        "",
        tuple(notes),
    )


def _charts(values: Sequence[float], settings: ChartSettings, standard: Standard) -> tuple[Charted, ...]:
    return charts_of(values, settings, standard) if len(values) >= settings.subgroup else ()


def _day(line: RunLine) -> date:
    return line.started_at.astimezone(UTC).date()
