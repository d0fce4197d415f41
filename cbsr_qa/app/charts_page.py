"""The page of ``cbsr-qa charts``: which charts signal first, then every chart."""

from typing import Final

from cbsr_qa.app.charting import STANDS
from cbsr_qa.app.control_charts import Charts
from cbsr_qa.app.metric_chart import MetricChart
from cbsr_qa.domain.report import Block, Paragraph, Section
from cbsr_qa.domain.station_charts import ChartKind, ChartReference
from cbsr_qa.report.figures_charts import ChartPart, control_figure
from cbsr_qa.report.numbers import number, plural, unit_shown
from cbsr_qa.report.page import Banner, Page
from cbsr_qa.report.render import render_sections

_READING: Final = (
    "A chart holds every run's figure against limits that come from a reference period, in which the station was "
    "known to be well. {limits} They say nothing about whether a sensor is good. "
    "A signal says that the station, its surroundings or what is fed to it has "
    "changed: it asks for a look, at a golden sensor first, since a new batch of material signals too.",
    f"A signal stands until {STANDS} runs in a row gave none. While one stands, every report of the station says so. "
    "After the cause was found and mended, a new reference period makes new limits; the old ones stay stored.",
)
_LIMITS: Final = {
    ChartKind.INDIVIDUALS: "three deviations away from the mean (i-mr)",
    ChartKind.MEANS: "three deviations of a mean away (xbar-r)",
    ChartKind.EWMA: "{width:g} deviations of the average away (ewma)",
    ChartKind.CUSUM: "{threshold:g} deviations of single runs away from zero (cusum)",
}


def _reading(found: Charts) -> tuple[str, ...]:
    """How to read the page: where limits are goes by the kinds of charts on it."""
    settings = [one.reference.settings for one in found.charts if one.reference is not None]
    kinds = dict.fromkeys(_LIMITS[one.kind].format(width=one.width, threshold=one.threshold) for one in settings)
    away = f"Limits are {' or '.join(kinds)}; a deviation is what runs after each other differ by."
    return _READING[0].format(limits=away if kinds else "Nothing is charted here now."), *_READING[1:]


def charts_html(found: Charts) -> str:
    """Return the page as one HTML document."""
    return render_sections(_head(found), _sections(found))


def _head(found: Charts) -> Page:
    signals, charted = found.signals, [one for one in found.charts if one.reference is not None]
    if signals:
        reason = "; ".join(signal.words() for signal in signals[:3])
        banner = Banner("fail", "✗", f"{plural(len(signals), 'chart')} out of control", reason)
    else:
        banner = Banner("pass", "✓", "In control", f"no signal stands on any of {plural(len(charted), 'chart')}")
    facts = (
        ("Station", found.request.station),
        ("Recipe", found.recipe),
        ("Charted are", f"golden sensor {found.request.golden}" if found.request.golden else "production runs"),
        ("Runs", str(found.runs)),
    )
    simulated = ("the runs charted here",) if found.simulated else ()
    return Page("Control charts", found.request.station, banner, facts, simulated, found.notes)


def _sections(found: Charts) -> list[Section]:
    sections = [Section("How to read this page", tuple(Paragraph(words) for words in _reading(found)))]
    return [*sections, *(Section(one.label, tuple(_blocks(one))) for one in found.charts)]


def chart_words(one: MetricChart) -> tuple[str, ...]:
    """Say how one chart stands and what its limits rest on."""
    if one.reference is None:
        return (f"No chart: {one.why}.", *one.notes)
    signal = one.signal
    since = len(one.values) - one.phase_1
    said = "No signal stands" if signal is None else f"Out of control: {signal.words().partition(', signals ')[2]}"
    return (
        f"{said}; {plural(since, 'run')} after the reference period.",
        reference_words(one, one.reference),
        *one.notes,
    )


def reference_words(chart: MetricChart, one: ChartReference) -> str:
    """Say what a chart's limits rest on, and who set them when."""
    unit = unit_shown(one.unit)
    unit = f" {unit}" if unit else ""
    size = f"mean {number(one.mean, 4)}{unit}, deviation {number(one.deviation)}{unit}"
    why = f" ({one.why})" if one.why else ""
    rules = (
        f"; Nelson's rules {', '.join(map(str, one.settings.rules))}"
        if one.settings.kind in ("i-mr", "xbar-r")
        else ""
    )
    return (
        f"Limits: {size}, from {one.runs} runs ({chart.named_run(one.first_run)} to "
        f"{chart.named_run(one.last_run)}), set by {one.operator or 'nobody named'} on "
        f"{one.made_at:%Y-%m-%d}{why}{rules}."
    )


def _blocks(one: MetricChart) -> list[Block]:
    tone = "warning" if one.signal is not None or one.reference is None else "plain"
    first, *rest = chart_words(one)
    blocks: list[Block] = [Paragraph(first, tone), *(Paragraph(words) for words in rest)]
    parts = [ChartPart(charted.chart, charted.ends) for charted in one.before]
    parts += [ChartPart(c.chart, [one.phase_1 + end for end in c.ends]) for c in one.after]
    if parts:
        blocks.append(control_figure(parts, one.phase_1, one.unit, label=one.label))
    return blocks
