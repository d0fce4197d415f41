"""Content of the views of a shift, of a sensor, of a run, and of a search for sensors."""

from base64 import b64encode
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import TYPE_CHECKING, Any, Final

from starlette.exceptions import HTTPException

from cbsr_qa.config.paths import database_url
from cbsr_qa.config.serials import validate_serial
from cbsr_qa.domain.errors import CbsrError, ConfigError
from cbsr_qa.domain.plan.limits import Outcome, choose_disposition, name_limit
from cbsr_qa.domain.results.fleet import MetricKey, RunSelection
from cbsr_qa.domain.results.listed import ListedRun
from cbsr_qa.domain.results.measurement import describe_judgement, metric_words, rank_judged
from cbsr_qa.domain.results.report import Banner, Figure, Section
from cbsr_qa.domain.run.states import EndReason, name_stopper
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.web.gate import read_disposition
from cbsr_qa.web.outcomes import SHOWN_OUTCOMES, describe_decision, standing_words
from cbsr_qa.web.texts import refusal_words, text

if TYPE_CHECKING:
    from cbsr_qa.app.shift.sensors import Handover
    from cbsr_qa.studies.charts.charting import MetricChart

#: Most charts drawn of a station, recipe and golden sensor; those that signal come first.
_MAX_CHARTS: Final = 6
#: Most drawings kept: a chart is drawn again only once it has another run.
_MAX_CACHED: Final = 64


@dataclass(frozen=True, slots=True)
class ChartPicture:
    """A drawn chart. ``source``: address of an image that brings its own data."""

    title: str
    source: str
    alternative: str


@dataclass(frozen=True, slots=True)
class StationChartsView:
    """Charts of a station's runs of one recipe, of production or of one golden sensor.

    Parameters
    ----------
    banner : state of the charts; None if they could not be made.
    why : reason in that case; else empty.
    left : number of charts that are not drawn.
    """

    station: str
    recipe: str
    golden: str
    banner: Banner | None
    why: str
    pictures: tuple[ChartPicture, ...]
    left: int


def shift_page(
    database: str | None, stations: tuple[str, ...], in_progress: frozenset[str] = frozenset()
) -> dict[str, Any]:
    """Return the content of the shift view: today's sensors and runs of the served stations.

    A run that began before midnight is today's too if it has gone on since, or was resumed.
    """
    from cbsr_qa.app.shift.sensors import sort_for_handover
    from cbsr_qa.app.shift.summary import local_day, summarise_runs  # imports all of statistics

    since, until = local_day()
    selection = RunSelection(stations=stations, from_moment=since, before_moment=until, checks=False)
    with open_store(database_url(database)) as store:
        evening = replace(selection, from_moment=since - timedelta(days=1), before_moment=since)
        before = store.lists.read_runs(evening)
        resumed = store.lists.find_resumed([run.run for run in before], since)
        over_midnight = [
            run
            for run in before
            if run.run in in_progress | resumed or run.started_at + timedelta(seconds=run.station_s) > since
        ]
        runs = (*over_midnight, *store.lists.read_runs(selection))
        earlier = _find_standing(store, runs, in_progress)
        references = {name: store.charts.read_current(name) for name in stations}
    groups = dict.fromkeys(
        (name, reference.recipe, reference.golden or "")
        for name, station_references in references.items()
        for reference in station_references
    )
    handover = sort_for_handover((*earlier, *runs), in_progress)
    summary = summarise_runs(runs)
    return {
        "day": since,
        "summary": summary,
        "codes_given": summarise_runs([run for run in runs if run.verdict is Outcome.FAIL]).codes,
        "handover": handover,
        "sentence": _describe_handover(handover),
        "limit_words": {key.label: _describe_limit(key) for run in runs for key in run.failed},
        "running_at": Counter(run.station for run in runs if run.run in in_progress),
        "runs": tuple(reversed(runs)),
        "charts": tuple(_charts(database, *group) for group in groups),
    }


def _find_standing(
    store: Repository, runs: tuple[ListedRun, ...], in_progress: frozenset[str]
) -> tuple[ListedRun, ...]:
    """Return the failures before a shift that stand, though the sensors passed in it with other recipes."""
    latest = {run.serial: run for run in runs if run.run not in in_progress and not run.of_check}
    passed = [run for run in latest.values() if run.passed]
    failed = [store.live.find_standing_failure(run.serial, run.recipe) for run in passed]
    known = {run.run for run in runs}
    return store.lists.read_named(sorted(run.run for run in failed if run is not None and run.run not in known))


def _describe_handover(handover: "Handover") -> str:
    """Say what became of the sensors of a shift, to be read aloud."""
    from cbsr_qa.app.shift.sensors import count_sensors

    counts = {
        "handover.passed": handover.passed,
        "handover.failed": count_sensors(handover.failed),
        "handover.undecided": count_sensors(handover.undecided),
    }
    tested = handover.tested
    words = text("handover.none")
    if tested:
        ends = ", ".join(text(end, count=count) for end, count in counts.items() if count)
        words = text("handover.one" if tested == 1 else "handover.tested", count=tested, ends=ends)
    if running := count_sensors(handover.running):
        words += text("handover.one_runs" if running == 1 else "handover.run", count=running)
    failed = []
    for state in handover.failed:
        codes = state.shown.failure_codes
        sensor = " ".join(filter(None, (state.last.serial, ", ".join(map(str, codes)))))
        todo = choose_disposition(codes)
        failed.append(text("handover.one_failed", sensor=sensor, todo=todo) if todo else sensor)
    return f"{words}." + (text("handover.failed_are", sensors="; ".join(failed)) if failed else "")


def _describe_limit(key: MetricKey) -> str:
    """Name a limit with its phase, which alone in brackets looks like a recipe."""
    name = name_limit(metric_words(key.name), key.qualifier, key.location)
    return text("shift.in_phase", limit=name, phase=key.phase) if key.phase else name


def describe_run(run: ListedRun) -> str:
    """Return the reason of a run's verdict, or who stopped it; without the step, which is in its report.

    Of a run that failed several limits the reason is the worst, and their number is said first.
    """
    if run.end is EndReason.ABORTED and run.end_detail and not run.altered:
        return text("station.stopped_by", who=name_stopper(run.end_detail))
    if run.failures > 1 and run.decision is None and not run.altered:
        return text("shift.worst", count=run.failures, reason=run.reason)
    return describe_decision(run)


def _charts(database: str | None, station: str, recipe: str, golden: str) -> StationChartsView:
    from cbsr_qa.studies.charts.charts import control_charts
    from cbsr_qa.studies.charts.report import charts_outcome
    from cbsr_qa.studies.charts.request import ChartsRequest

    try:
        charts = control_charts(ChartsRequest(station, recipe, golden or None), database=database)
    except CbsrError as error:
        return StationChartsView(station, recipe, golden, None, error.reason, (), 0)
    outcome = charts_outcome(charts)
    sections = outcome.sections[-len(charts.charts) :]  # the sections of single charts come last
    drawn = sorted(zip(charts.charts, sections, strict=True), key=lambda one: one[0].signal is None)[:_MAX_CHARTS]
    pictures = tuple(picture for chart, section in drawn for picture in _pictures(chart, section))
    undrawn = len(charts.charts) - len(drawn)
    return StationChartsView(station, recipe, golden, outcome.page.banner, "", pictures, undrawn)


_kept: dict[tuple[object, ...], str] = {}


def _pictures(chart: "MetricChart", section: Section) -> Iterator[ChartPicture]:
    for block in section.blocks:
        if isinstance(block, Figure):
            key = (chart.reference, chart.runs, chart.values)
            if key not in _kept:
                svg = block.svg if isinstance(block.svg, str) else block.svg()
                _kept[key] = f"data:image/svg+xml;base64,{b64encode(svg.encode()).decode()}"
                while len(_kept) > _MAX_CACHED:
                    del _kept[next(iter(_kept))]
            yield ChartPicture(section.title, _kept[key], block.alternative)


def sensor_page(database: str | None, serial: str) -> dict[str, Any]:
    """Return the content of the view of a sensor."""
    from cbsr_qa.app.shift.lists import sensor_runs

    validate_serial(serial)
    with open_store(database_url(database)) as store:
        runs = sensor_runs(store, serial)
        altered = store.sensors.find_altered_lately({run.run for run in runs})
        if not runs:
            raise HTTPException(404, text("problem.no_sensor", serial=serial))
        standing = _describe_standing(store, runs[-1])
    return {"serial": serial, "runs": tuple(reversed(runs)), "altered": len(altered), "standing": standing}


def run_page(database: str | None, run: str) -> dict[str, Any]:
    """Return the content of the view of a run, with the limits that decided its outcome, the worst first."""
    with open_store(database_url(database)) as store:
        runs = store.lists.read_named([run])
        if not runs:
            raise HTTPException(404, text("problem.no_run"))
        measurements = store.lists.read_limited_measurements([run]).get(run, [])
        standing = _describe_standing(store, runs[0])
    outcome = None if runs[0].altered else runs[0].outcome
    decisive = rank_judged(measurements, outcome) if outcome in SHOWN_OUTCOMES else []
    limits = tuple(describe_judgement(measurement) for measurement in decisive)
    return {"run": runs[0], "limits": limits, "standing": standing}


def _describe_standing(store: Repository, run: ListedRun) -> str:
    """Say which failure with another recipe stands, and what to do; empty of a sensor that is as good as its run."""
    failed = store.live.find_standing_failure(run.serial, run.recipe) if run.passed else None
    if failed is None:
        return ""
    todo = read_disposition(store, failed)
    todo = f"{todo[:1].upper()}{todo[1:]}." if todo else text("todo.fail")
    return f"{standing_words(failed, run.recipe)} {text('station.what_to_do')}: {todo}"


def search_page(database: str | None, wanted: str) -> dict[str, Any]:
    """Return the content of the page of a search: sensors, or why a text cannot be a name."""
    from cbsr_qa.app.shift.sensors import OPERATOR_RUNS, search_sensors

    view: dict[str, Any] = {"wanted": wanted, "found": None, "refused": "", "operator_runs": OPERATOR_RUNS}
    if not wanted:
        return view
    try:
        with open_store(database_url(database)) as store:
            return view | {"found": search_sensors(store, wanted)}
    except ConfigError as error:
        return view | {"refused": refusal_words(error)}
