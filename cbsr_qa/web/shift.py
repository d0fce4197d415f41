"""Content of the views of a shift and of a sensor."""

from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from starlette.exceptions import HTTPException

from cbsr_qa.config.paths import database_url
from cbsr_qa.config.serials import validate_serial
from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.report import Banner, Figure, Section
from cbsr_qa.store.opening import open_store
from cbsr_qa.web.texts import text

if TYPE_CHECKING:
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


def shift_page(database: str | None, stations: tuple[str, ...]) -> dict[str, Any]:
    """Return the content of the shift view: today's runs of the served stations."""
    from cbsr_qa.app.shift.summary import local_day, shift_summary  # imports all of statistics

    since, until = local_day()
    selection = RunSelection(stations=stations, from_moment=since, before_moment=until, checks=False)
    with open_store(database_url(database)) as store:
        summary = shift_summary(store, selection)
        runs = store.lists.read_runs(selection)
        references = {name: store.charts.read_current(name) for name in stations}
    groups = dict.fromkeys(
        (name, reference.recipe, reference.golden or "")
        for name, station_references in references.items()
        for reference in station_references
    )
    charts = tuple(_charts(database, *group) for group in groups)
    return {"day": since, "summary": summary, "runs": tuple(reversed(runs)), "charts": charts}


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
    if not runs:
        raise HTTPException(404, text("problem.no_sensor", serial=serial))
    return {"serial": serial, "runs": tuple(reversed(runs))}
