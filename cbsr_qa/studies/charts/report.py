"""Report of a station's control charts: the state of each, then those with signals, drawn and in words."""

from collections.abc import Iterator
from typing import Final

from cbsr_qa.domain.numbers import prefix_kind
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.charts import ChartKind, ChartReference
from cbsr_qa.domain.results.report import Banner, Block, Cell, CommandOutcome, Figure, Page, Paragraph, Section
from cbsr_qa.report.tables import capital, number, plural, text_table, unit_column, unit_shown
from cbsr_qa.studies.charts.charting import MOST_DRAWN, STANDS, MetricChart
from cbsr_qa.studies.charts.charts import Charts

_NONE: Final = "–"
_COLUMNS: Final = ("chart", "unit", "mean", "deviation", "limits", "latest", "reference", "runs since", "state")

_READING: Final = (
    "A chart compares each run with limits from a reference period, in which the station was known to be good. "
    "{limits} They say nothing about whether a sensor is good. A signal says that the station, its surroundings or "
    "the material has changed. Measure a golden sensor first: a new batch of material causes signals too.",
    f"A signal stays active until {STANDS} successive runs are without one. As long as it is active, every report"
    " of the station says so. After the cause is repaired, set a new reference period; the old limits stay stored.",
)
_AWAY: Final = "Limits are {kinds}; a deviation is that of single runs from one to the next."
_LIMITS: Final = {
    ChartKind.INDIVIDUALS: "three deviations from the mean (i-mr)",
    ChartKind.MEANS: "three deviations of a group's mean from the mean (xbar-r)",
    ChartKind.EWMA: "{width:g} deviations of the average from the mean (ewma)",
    ChartKind.CUSUM: "{threshold:g} deviations from zero (cusum)",
}
_NOTHING: Final = "Nothing is charted now."

# Sentences, in reading order.
_SIGNALS: Final = "{signals} of {charts} of {station} {verb}; the first: {words}"
_WELL: Final = "no signal on {charts} of {station}"
_RETIRED: Final = "all charts of {station} and this recipe are retired"
_SET: Final = "{chart} set{by} on {day}{why}{rules}"
_CAPTION: Final = "Mean, deviation, limits and latest point of each chart, in its unit."
_FIGURE: Final = "{label}. Grey: the reference period. Dashed: limits. Orange: points that break a rule.{cut}"
_CUT: Final = f" Only the latest {MOST_DRAWN} runs are drawn."
_ALTERNATIVE: Final = "Control charts of {label}; the table and the sentences above give their state."
_NO_CHART: Final = "No chart: {why}."


def charts_outcome(charts: Charts) -> CommandOutcome[Charts]:
    """Lay charts out; the exit code is 1 if a signal is active."""
    sections = [Section("How to read this page", tuple(_explain_page(charts)), page_only=True)]
    if charts.charts:
        rows = [_row(chart) for chart in charts.charts]
        sections.append(Section("Charts", (text_table(_CAPTION, _COLUMNS, rows, (2, 3, 4, 5, 7)),)))
    shared: tuple[str, ...] = ()
    if len(charts.charts) > 1:  # the page shows once what is noted of every chart
        notes = charts.charts[0].notes
        shared = tuple(note for note in notes if all(note in chart.notes for chart in charts.charts))
    sections += [
        Section(unit_column(capital(chart.label), chart.unit), tuple(_blocks(chart, shared)))
        for chart in charts.charts
    ]
    return CommandOutcome(charts, _page(charts, shared), tuple(sections), 0 if charts.in_control else 1)


def _page(charts: Charts, shared: tuple[str, ...]) -> Page:
    charted = [chart.reference for chart in charts.charts if chart.reference is not None]
    facts = (
        ("Station", charts.station),
        ("Recipe", charts.recipe),
        ("Charted", f"golden sensor {charts.golden}" if charts.golden else "production runs"),
        ("Runs", str(charts.runs)),
        *(("Limits", text) for text in dict.fromkeys(map(_set, charted))),
        *((("Stored", plural(len(charted), "new reference")),) if charts.stored else ()),
    )
    simulated = ("all charted runs",) if charts.simulated else ()
    return Page(
        "Control charts", charts.station, _banner(charts, len(charted)), facts, simulated, (*charts.notes, *shared)
    )


def _banner(found: Charts, charted: int) -> Banner:
    station, charts = prefix_kind("station", found.station), plural(charted, "chart")
    if not found.in_control:
        first = min(found.signals, key=lambda signal: signal.since).words()
        count = len(found.signals)
        verb = "signals" if count == 1 else "signal"
        reason = _SIGNALS.format(signals=count, charts=charts, station=station, verb=verb, words=first)
        return Banner("fail", "✗", "Out of control", reason)
    if not charted:
        return Banner("plain", _NONE, "Nothing is charted", _RETIRED.format(station=station))
    return Banner("pass", "✓", "In control", _WELL.format(charts=charts, station=station))


def _set(limits: ChartReference) -> str:
    by_operator = f" by {limits.operator}" if limits.operator else ""
    why = f" ({limits.why})" if limits.why else ""
    ruled = limits.chart in (ChartKind.INDIVIDUALS, ChartKind.MEANS)
    rules = f"; Nelson's rules {', '.join(map(str, limits.rules))}" if ruled else ""
    return _SET.format(chart=limits.chart, by=by_operator, day=f"{limits.made_at:%Y-%m-%d}", why=why, rules=rules)


def _explain_page(charts: Charts) -> Iterator[Paragraph]:
    limits = [chart.reference for chart in charts.charts if chart.reference is not None]
    kinds = dict.fromkeys(
        _LIMITS[limit.chart].format(width=limit.width, threshold=limit.threshold) for limit in limits
    )
    away = _AWAY.format(kinds=" or ".join(kinds)) if kinds else _NOTHING
    yield from (Paragraph(text.format(limits=away)) for text in _READING)


def _row(chart: MetricChart) -> tuple[str | Cell, ...]:
    limits = chart.reference
    if limits is None:
        return chart.label, unit_shown(chart.unit), *[_NONE] * 6, Cell("no chart", Outcome.NOT_MEASURED)
    days = " to ".join(map(str, chart.reference_days)) if chart.reference_days else _NONE
    state = Cell("in control", Outcome.PASS)
    if chart.signal is not None:
        state = Cell(
            f"signals since {chart.signal.since:%Y-%m-%d} ({plural(chart.signal.runs, 'run')})", Outcome.FAIL
        )
    # Chart of the latest points (for a pair, the first).
    latest = next((part for part in reversed(chart.charts) if part.name == chart.charts[0].name), None)
    return (
        chart.label,
        unit_shown(chart.unit),
        number(limits.mean, 4),
        number(limits.deviation),
        f"{number(latest.lower[-1], 4)} to {number(latest.upper[-1], 4)}" if latest else _NONE,
        number(latest.points[-1], 4) if latest else _NONE,
        f"{plural(limits.runs, 'run')}, {days}",
        str(len(chart.values) - chart.reference_runs),
        state,
    )


def _blocks(chart: MetricChart, shared: tuple[str, ...]) -> Iterator[Block]:
    if chart.reference is None:
        yield Paragraph(_NO_CHART.format(why=chart.why), "warning")
    if chart.signal is not None:
        yield Paragraph(f"S{chart.signal.describe_since()[1:]}.", "warning")
    yield from (Paragraph(f"{capital(note)}.", "note") for note in chart.notes if note not in shared)
    if chart.charts:
        yield _figure(chart)


def _figure(chart: MetricChart) -> Figure:
    def draw() -> str:
        # loads matplotlib
        from cbsr_qa.studies.charts.figures import control_charts_svg

        return control_charts_svg(chart)

    cut = _CUT if len(chart.runs) > MOST_DRAWN else ""
    return Figure(_FIGURE.format(label=chart.label, cut=cut), _ALTERNATIVE.format(label=chart.label), draw)
