"""Stations whose runs are charted: for a user who does not know, or no longer knows, which there are."""

from dataclasses import dataclass
from datetime import date
from itertools import groupby
from typing import Final

from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.results.charts import ChartReference
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Page, Section
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import list_names, plural, text_table
from cbsr_qa.store.opening import open_store

_COLUMNS: Final = ("station", "recipe", "charted", "chart", "metrics", "reference set")
_NEXT: Final = "cbsr-qa charts --station STATION shows them"
_NONE_REASON: Final = (
    "store a reference period first: cbsr-qa charts --station STATION --reference-runs N --operator NAME"
)


@dataclass(frozen=True, slots=True)
class ListedChart:
    """Charts of one kind on one station.

    Parameters
    ----------
    golden : serial of the golden sensor whose runs are charted; None for production runs.
    metrics : names of the charted metrics, with the place of each that is charted by location.
    set_on : day of the latest reference period, UTC.
    """

    station: str
    recipe: str
    golden: str | None
    chart: str
    metrics: tuple[str, ...]
    set_on: date


@dataclass(frozen=True, slots=True)
class ListedCharts:
    """All charts with a reference period that holds, by station."""

    charted: tuple[ListedChart, ...]


def list_charts(*, database: str | None = None) -> CommandOutcome[ListedCharts]:
    """List the charts of all stations; exit code 0, also where there are none."""
    with open_store(database_url(database), create=False) as store:
        references = sorted(store.charts.read_current(), key=_group_key)
    charted = tuple(_list_chart(tuple(members)) for _, members in groupby(references, key=_group_key))
    stations = dict.fromkeys(chart.station for chart in charted)
    if not charted:
        page = Page("", "", Banner("plain", "–", "No station is charted", _NONE_REASON), ())
        return CommandOutcome(ListedCharts(()), page)
    rows = [
        (
            chart.station,
            chart.recipe,
            f"golden sensor {chart.golden}" if chart.golden else "production runs",
            chart.chart,
            list_names(chart.metrics),
            str(chart.set_on),
        )
        for chart in charted
    ]
    outcome = answer(ListedCharts(charted), f"{plural(len(stations), 'station')} with charts", _NEXT)
    table = text_table("By station and recipe.", _COLUMNS, rows)
    return CommandOutcome(outcome.result, outcome.page, (Section("Charts", (table,)),))


def _group_key(reference: ChartReference) -> tuple[str, str, str, str]:
    return reference.station, reference.recipe, reference.golden or "", str(reference.chart)


def _list_chart(references: tuple[ChartReference, ...]) -> ListedChart:
    station, recipe, golden, chart = _group_key(references[0])
    metrics = tuple(sorted({reference.key.title for reference in references}))
    return ListedChart(
        station, recipe, golden or None, chart, metrics, max(reference.made_at.date() for reference in references)
    )
