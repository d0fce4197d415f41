"""The page of ``cbsr-qa gauge``: sentences first, then panels and tables, one section a metric."""

from typing import Final

from cbsr_qa.app.gauge import Gauge, MetricGauge
from cbsr_qa.app.gauge_reference_words import reference_tables
from cbsr_qa.app.gauge_words import (
    GOOD_PERCENT,
    LEAST_CATEGORIES,
    POOR_PERCENT,
    deviation_words,
    listed,
    metric_words,
    percent,
    period_words,
    source_of_variation,
    source_words,
    study_words,
)
from cbsr_qa.domain.report import Block, Paragraph, Section, Table
from cbsr_qa.report.figures_gauge import gauge_figure
from cbsr_qa.report.numbers import number, plural
from cbsr_qa.report.page import Banner, Page
from cbsr_qa.report.render import render_sections
from cbsr_qa.report.tables import text_table, unit_column

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
        blocks += [_components(one, confidence), _anova(one, appraiser)]
    if one.against is not None:
        blocks += reference_tables(one.against, appraiser, confidence)
    if one.missing and one.study is not None:
        blocks.append(Paragraph(f"Uneven: {listed(one.missing, 20)}.", "note"))
    return blocks


def _components(one: MetricGauge, confidence: float) -> Table:
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
