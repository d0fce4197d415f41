"""The page of ``cbsr-qa gauge``: sentences first, then panels and tables, one section a metric.

The six usual panels of a gauge study (AIAG MSA 4th edition, chapter III), and bias against reference values.
"""

from collections.abc import Sequence
from math import sqrt
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.results import Block, Figure, Paragraph, Section, Table
from cbsr_qa.report import Banner, Page, number, plural, render_sections, text_table, unit_column, unit_shown
from cbsr_qa.report.draw import BLUE, CYCLE, FAINT, QUIET, VERMILION, canvas, drawn, light_grid
from cbsr_qa.stats import d2_d3
from cbsr_qa.stats.gauge import Study, Variation
from cbsr_qa.studies.gauge.study import Gauge, MetricGauge
from cbsr_qa.studies.gauge.words import (
    GOOD_PERCENT,
    LEAST_CATEGORIES,
    POOR_PERCENT,
    deviation_words,
    listed,
    metric_words,
    percent,
    period_words,
    reference_tables,
    source_of_variation,
    source_words,
    study_words,
)

#: Names along an axis that fit beside each other.
_MOST_NAMES = 12
#: Names beside each other in a legend, and the height of one of its rows [in].
_LEGEND_COLUMNS = 3
_LEGEND_ROW_IN = 0.15


def gauge_figure(study: Study, variation: Variation, unit: str, *, label: str, appraiser: str) -> Figure:
    """Draw components, values by sensor and by appraiser, their interaction, and the charts of ranges and means.

    Parameters
    ----------
    variation : by analysis of variance.
    unit : of the values.
    label : of the metric.
    appraiser : what measures: ``"station"`` or ``"operator"``.
    """
    shown = unit_shown(unit)

    def axis(of: str) -> str:
        return f"{of} [{shown}]" if shown else of

    def build() -> Canvas:
        figure, axes = _panels(_LEGEND_ROW_IN * _legend_rows(study))
        _components(axes[0], variation)
        _by_sensor(axes[1], study)
        _ranges(axes[2], study, appraiser)
        _by_appraiser(axes[3], study, appraiser)
        _means(axes[4], study, appraiser)
        _interaction(axes[5], study, appraiser)
        names = ("share [%]", axis("each run"), axis("range"), axis("each run"), axis("mean"), axis("mean"))
        for one, name in zip(axes, names, strict=True):
            one.set_ylabel(name)
        return figure

    return drawn(
        build,
        caption=f"Where the variation of {label} comes from. Components as shares; every run by sensor and by "
        f"{appraiser}, means joined; ranges of repeated runs, beyond whose limit a cell repeats worse than the rest; "
        "means of cells against limits of repeatability alone, most of which should be outside: then the gauge tells "
        f"sensors apart; and means of each sensor by {appraiser}: lines that cross are an interaction.",
        alternative=f"Six panels of the gauge study of {label}; the table has the components.",
    )


def _panels(below: float) -> tuple[Canvas, list[Axes]]:
    """Six axes, row by row, with so much room [in] for the legend below the last."""
    height = 7.7 + below
    figure = canvas(height)
    bottom, top = (0.55 + below) / height, 1 - 0.25 / height
    grid = figure.add_gridspec(3, 2, left=0.09, right=0.985, bottom=bottom, top=top, hspace=0.55, wspace=0.24)
    return figure, [figure.add_subplot(grid[row, column]) for row in range(3) for column in range(2)]


def _components(axes: Axes, variation: Variation) -> None:
    names = ("gauge", "repeatability", "reproducibility", "sensor")
    parts = [getattr(variation, name) for name in names]
    bars = [("of the variance", [variation.percent_contribution(part) for part in parts])]
    bars.append(("of the deviation", [variation.percent_study(part) for part in parts]))
    if variation.tolerance is not None:
        bars.append(("of the tolerance", [variation.percent_tolerance(part) or 0.0 for part in parts]))
    width = 0.8 / len(bars)
    light_grid(axes)
    for row, (name, heights) in enumerate(bars):
        across = np.arange(len(parts)) + (row - (len(bars) - 1) / 2) * width
        axes.bar(across, heights, 0.92 * width, color=CYCLE[row], label=name)
    axes.set_xticks(range(len(parts)), ["gauge R&R", "repeat.", "reprod.", "sensors"])
    axes.set_title("components")
    _legend_below(axes, 0.24)


def _by_sensor(axes: Axes, study: Study) -> None:
    axes.set_title("by sensor")
    _dots(axes, [study.values[row].ravel() for row in range(study.shape[0])], study.sensors)


def _by_appraiser(axes: Axes, study: Study, appraiser: str) -> None:
    axes.set_title(f"by {appraiser}")
    _dots(axes, [study.values[:, column].ravel() for column in range(study.shape[1])], study.stations)


def _dots(axes: Axes, groups: Sequence[np.ndarray], names: Sequence[str]) -> None:
    light_grid(axes)
    for place, group in enumerate(groups):
        axes.plot(np.full(len(group), place), group, "o", color=FAINT, markersize=2.4)
    axes.plot(range(len(groups)), [group.mean() for group in groups], "o-", color=BLUE, markersize=3.4)
    _names(axes, names)


def _ranges(axes: Axes, study: Study, appraiser: str) -> None:
    ranges = np.ptp(study.values, axis=2)
    d2, d3 = d2_d3(study.shape[2])
    mean = float(ranges.mean())
    low, high = max(0.0, mean * (1 - 3 * d3 / d2)), mean * (1 + 3 * d3 / d2)
    axes.set_title(f"range of repeated runs, by {appraiser}")
    _cells(axes, ranges, study, mean, low, high)
    axes.set_ylim(bottom=0)


def _means(axes: Axes, study: Study, appraiser: str) -> None:
    means = study.values.mean(axis=2)
    d2, _ = d2_d3(study.shape[2])
    half = 3 * float(np.ptp(study.values, axis=2).mean()) / (d2 * sqrt(study.shape[2]))
    mean = float(means.mean())
    axes.set_title(f"mean of repeated runs, by {appraiser}")
    _cells(axes, means, study, mean, mean - half, mean + half)


def _cells(axes: Axes, table: np.ndarray, study: Study, centre: float, low: float, high: float) -> None:
    """Draw one statistic of each cell, the sensors of one appraiser after those of another, with limits."""
    count = study.shape[0]
    for column, name in enumerate(study.stations):
        across, values = column * count + np.arange(count), table[:, column]
        axes.plot(across, values, "-", color=FAINT, linewidth=0.7)
        outside = (values < low) | (values > high)
        for flags, colour in ((~outside, BLUE), (outside, VERMILION)):
            axes.plot(across[flags], values[flags], "o", color=colour, markersize=2.8)
        if column:
            axes.axvline(column * count - 0.5, color=FAINT, linewidth=0.5)
        if len(study.stations) <= _MOST_NAMES:
            place = (column + 0.5) / len(study.stations)
            axes.text(place, -0.05, name[:16], transform=axes.transAxes, ha="center", va="top", fontsize=6.5)
    for line, style in ((centre, "-"), (low, "--"), (high, "--")):
        axes.axhline(line, color=QUIET, linewidth=0.7, linestyle=style)
    axes.set_xticks([])


def _interaction(axes: Axes, study: Study, appraiser: str) -> None:
    light_grid(axes)
    axes.set_title(f"sensor by {appraiser}")
    means = study.values.mean(axis=2)
    for column, name in enumerate(study.stations):
        colour, dashes = CYCLE[column % len(CYCLE)], ("-", "--", ":")[column // len(CYCLE) % 3]
        axes.plot(means[:, column], "o", linestyle=dashes, color=colour, markersize=2.6, label=name[:16])
    if len(study.stations) <= _MOST_NAMES:
        _legend_below(axes, 0.5)
    _names(axes, study.sensors)


def _legend_rows(study: Study) -> int:
    return -(-len(study.stations) // _LEGEND_COLUMNS) if len(study.stations) <= _MOST_NAMES else 0


def _legend_below(axes: Axes, gap_in: float) -> None:
    """Put the legend under the axes, where it covers nothing; ``gap_in`` is the room for names of ticks [in]."""
    canvas_in = axes.figure.dpi_scale_trans.inverted()
    place = (0.5, -gap_in / axes.get_window_extent().transformed(canvas_in).height)
    small = {"fontsize": 6.5, "handlelength": 1.4, "columnspacing": 1.2, "borderaxespad": 0.0, "borderpad": 0.0}
    axes.legend(frameon=False, ncols=_LEGEND_COLUMNS, loc="upper center", bbox_to_anchor=place, **small)


def _names(axes: Axes, names: Sequence[str]) -> None:
    every = -(-len(names) // _MOST_NAMES)
    places = range(0, len(names), every)
    short = [names[place][:10] for place in places]
    turned = 30 if sum(map(len, short)) > 48 else 0
    axes.set_xticks(list(places), short, rotation=turned, ha="right" if turned else "center", fontsize=6.5)


_READING: Final = (
    "Sensors differ, and so does what is measured of one sensor: from run to run (repeatability), and from one "
    "station or operator to another (reproducibility). Both together are the gauge. A gauge that differs as much as "
    "the sensors do cannot tell them apart; one that differs as much as the limits are wide passes and fails by "
    "chance.",
    "Each figure is the mean over a run's loads. Components come from an analysis of variance with all effects "
    "random; an interaction of sensor and station that is not significant (p above 0.25) is counted as "
    "repeatability. By ranges is the older method of averages and ranges, which sees no interaction and has no "
    "intervals. Both follow AIAG, Measurement Systems Analysis, 4th edition, whose bands are below "
    f"{GOOD_PERCENT:g} % (good) and above {POOR_PERCENT:g} % (not good enough) of deviation or tolerance, "
    f"and {LEAST_CATEGORIES} distinct categories.",
)
_PARTS: Final = (
    ("gauge R&R", "gauge"),
    ("repeatability", "repeatability"),
    ("reproducibility", "reproducibility"),
    ("sensors", "sensor"),
    ("total", "total"),
)


def gauge_html(found: Gauge) -> str:
    """Return the page of a study as one HTML document."""
    return render_sections(_head(found), _sections(found))


def _head(found: Gauge) -> Page:
    studied = [one for one in found.metrics if one.anova is not None]
    worst = max(studied, key=_worst, default=None)
    if worst is None:
        banner = Banner("plain", "–", "No gauge study", "see what is missing below")
    else:
        share = _worst(worst)
        tone = "pass" if share < GOOD_PERCENT else "marginal" if share <= POOR_PERCENT else "fail"
        symbol = {"pass": "✓", "marginal": "≈", "fail": "✗"}[tone]
        whole = f"The gauge is {percent(share)} of the deviation at worst"
        banner = Banner(
            tone, symbol, whole, f"of {worst.series.key.label}, of {plural(len(studied), 'metric')} studied"
        )
    request = found.request
    source = (("Study", source_words(request.source)),) if request.source else ()
    period = (("Period", words),) if (words := period_words(request.since, request.until)) else ()
    facts = (
        *source,
        ("Recipe", found.runs[0].recipe),
        ("Sensors", str(len(found.sensors()))),
        (f"{request.appraiser.capitalize()}s", ", ".join(found.appraisers())),
        ("Runs", str(len(found.runs))),
        *period,
        ("Confidence of intervals", f"{100 * request.confidence:g} %"),
    )
    simulated = ("the runs of this study",) if found.simulated else ()
    return Page("Gauge study", study_words(found), banner, facts, simulated, found.notes)


def _worst(one: MetricGauge) -> float:
    assert one.anova is not None
    return one.anova.variation.percent_study(one.anova.variation.gauge)


def _sections(found: Gauge) -> list[Section]:
    sections = [Section("How to read this page", tuple(Paragraph(words) for words in _READING))]
    for one in found.metrics:
        sections.append(Section(one.series.key.label, tuple(_blocks(one, found))))
    return sections


def _blocks(one: MetricGauge, found: Gauge) -> list[Block]:
    appraiser, confidence = found.request.appraiser, found.request.confidence
    tone = "plain" if one.study is not None else "warning"
    blocks: list[Block] = [Paragraph(words, tone) for words in metric_words(one, appraiser, confidence)]
    if one.study is not None and one.anova is not None:
        label, unit = one.series.key.label, one.series.unit
        blocks.append(gauge_figure(one.study, one.anova.variation, unit, label=label, appraiser=appraiser))
        blocks += [_components_gauge_page(one, confidence), _anova(one, appraiser)]
    if one.against is not None:
        blocks += reference_tables(one.against, appraiser, confidence)
    if one.missing and one.study is not None:
        blocks.append(Paragraph(f"Uneven: {listed(one.missing, 20)}.", "note"))
    return blocks


def _components_gauge_page(one: MetricGauge, confidence: float) -> Table:
    assert one.anova is not None
    assert one.ranges is not None
    variation, by_range = one.anova.variation, one.ranges.variation
    rows = []
    for shown, name in _PARTS:
        part = getattr(variation, name)
        tolerance = variation.percent_tolerance(part)
        rows.append(
            (
                shown,
                number(part.deviation),
                deviation_words(part),
                percent(variation.percent_contribution(part)),
                percent(variation.percent_study(part)),
                "–" if tolerance is None else percent(tolerance),
                number(getattr(by_range, name).deviation),
            )
        )
    columns = (
        "component",
        unit_column("deviation", one.series.unit),
        f"{100 * confidence:g} % interval",
        "of variance",
        "of deviation",
        "of tolerance",
        "by ranges",
    )
    return text_table("Components of variation.", columns, rows, (1, 2, 3, 4, 5, 6))


def _anova(one: MetricGauge, appraiser: str) -> Table:
    assert one.anova is not None
    rows = [
        (
            source_of_variation(row.source, appraiser),
            str(row.freedom),
            number(row.squares),
            number(row.mean_square),
            "–" if row.statistic is None else number(row.statistic),
            "–" if row.p_value is None else number(row.p_value, 2),
        )
        for row in one.anova.table
    ]
    pooled = "its interaction is counted as repeatability" if one.anova.pooled else "its interaction stands by itself"
    columns = ("source", "degrees of freedom", "sum of squares", "mean square", "F", "p")
    table = text_table(f"Analysis of variance; {pooled}.", columns, rows, (1, 2, 3, 4, 5))
    return Table(table.caption, table.columns, table.rows, table.numeric, folded=True)
