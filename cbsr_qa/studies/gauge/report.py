"""Report of a gauge study: one section per metric, with grades, tables and the six panels."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import sqrt
from typing import Final

from cbsr_qa.domain.results.report import Banner, Block, CommandOutcome, Figure, Page, Paragraph, Section, Table
from cbsr_qa.report.tables import (
    capital,
    format_fixed,
    list_names,
    number,
    plural,
    text_table,
    unit_column,
    unit_shown,
)
from cbsr_qa.stats.gauge.type1 import CAPABLE
from cbsr_qa.stats.samples import Interval
from cbsr_qa.studies.gauge.reference_tables import list_reference_tables
from cbsr_qa.studies.gauge.references import Type1
from cbsr_qa.studies.gauge.study import GaugeStudy, MetricGauge

#: AIAG's bands for the gauge's share of the study variation or of the tolerance [%], and for categories.
_GOOD_PERCENT: Final = 10.0
_POOR_PERCENT: Final = 30.0
_LEAST_CATEGORIES: Final = 5

_PARTS: Final = (
    ("gauge R&R", "gauge"),
    ("repeatability", "repeatability"),
    ("reproducibility", "reproducibility"),
    ("sensors", "sensor"),
    ("total", "total"),
)
_NONE: Final = "–"

_PARTS_OF_VARIATION: Final = (
    "Sensors differ, and so do measurements of one sensor: from run to run (repeatability), and from one station or "
    "operator to another (reproducibility). Both together are the gauge. A gauge that varies as much as the sensors "
    "cannot distinguish them; one that varies as much as the limits are apart passes and fails sensors by chance."
)
_BANDS: Final = (
    f"Bands are AIAG's (Measurement Systems Analysis, 4th edition): good below {_GOOD_PERCENT:g} %, not good enough "
    f"above {_POOR_PERCENT:g} % of study variation or tolerance, at least {_LEAST_CATEGORIES} distinct categories."
)
_CROSSED: Final = (
    "Each value is the mean over the loads of a run. Components come from an analysis of variance with random "
    "effects; an interaction of sensor and station with p above 0.25 is pooled into repeatability. The column "
    "'by ranges' uses the older method of averages and ranges, which ignores the interaction and has no intervals. "
    f"{_BANDS}"
)
_NESTED: Final = (
    "The study is nested: each {appraiser} measured its own parts. Each value is the mean over the loads of a "
    "run. Components come from an analysis of variance with random effects. Only statistics tell how {appraiser}s "
    f"differ from how their parts do: use parts that are as alike as can be. {_BANDS}"
)
_DESTROYED: Final = (
    "A batch counts as one part, and its sensors as repeated runs. The repeatability includes how its sensors "
    "differ, so the gauge itself repeats at least as well as shown."
)

# Sentences, in reading order.
_SHARE: Final = (
    "The gauge accounts for {contribution} of the variance ({confidence:g} % interval {low} to {high}) and {study} "
    "of the study variation: {grade}."
)
_TOLERANCE: Final = (
    "Six standard deviations of the gauge take {share}{inside} of the {of}'s tolerance of {width}: {grade}."
)
_NO_TOLERANCE: Final = "Without a lower and an upper limit there is no tolerance to compare the gauge with."
_CATEGORIES: Final = "It distinguishes {count} of {of} (interval {inside}); at least {least} are needed."
_LARGEST: Final = "The largest part is {name}: standard deviation {deviation}, {share} of the gauge's variance."


def gauge_outcome(study: GaugeStudy) -> CommandOutcome[GaugeStudy]:
    """Lay a study out."""
    method = _CROSSED if study.nested is None else _NESTED.format(appraiser=study.appraiser)
    reading = (_PARTS_OF_VARIATION, method, *([_DESTROYED] if study.nested == "batch" else []))
    sections = [Section("How to read this page", tuple(map(Paragraph, reading)), page_only=True)]
    sections += [
        Section(unit_column(capital(metric.title), metric.unit), tuple(_blocks(metric, study)))
        for metric in study.metrics
    ]
    return CommandOutcome(study, _page(study), tuple(sections))


def _page(study: GaugeStudy) -> Page:
    facts = [("Recipe", study.recipe), ("Sensors", f"{len(study.sensors)} ({list_names(study.sensors)})")]
    if study.study is not None:
        facts.insert(0, ("Study", f"{study.study.name} ({study.study.file}, SHA-256 {study.study.sha256})"))
    facts.append((f"{study.appraiser.capitalize()}s", ", ".join(study.appraisers)))
    facts.append(("Runs", str(len(study.runs))))
    days = [f"{word} {day}" for word, day in (("from", study.since), ("to", study.until)) if day]
    facts += [("Period", f"{' '.join(days)} (UTC)")] if days else []
    subject = f"{plural(len(study.sensors), 'sensor')} by {plural(len(study.appraisers), study.appraiser)}"
    simulated = ("all runs of this study",) if study.simulated else ()
    return Page("Gauge study", subject, _banner(study), tuple(facts), simulated, study.notes)


def _banner(study: GaugeStudy) -> Banner:
    metric_percents = [
        (metric.anova.components.gauge.percent_study, metric.title) for metric in study.metrics if metric.anova
    ]
    if not metric_percents:
        type1_studies = [one for metric in study.metrics if metric.references for one in metric.references.type1]
        return _summarise_type1([one for one in type1_studies if one.cg is not None])
    worst_percent, label = max(metric_percents)
    tone, symbol = ("pass", "✓") if worst_percent < _GOOD_PERCENT else ("marginal", "≈")
    if worst_percent > _POOR_PERCENT:
        tone, symbol = "fail", "✗"
    worst_of = f", the worst of {plural(len(metric_percents), 'metric')}" if len(metric_percents) > 1 else ""
    grade, _, band = _grade(worst_percent).partition(" (")
    reason = f"{_percent(worst_percent)} of the study variation in {label}{worst_of} ({band}"
    return Banner(tone, symbol, f"The gauge is {grade}", reason)


def _summarise_type1(studies: Sequence[Type1]) -> Banner:
    """Return the headline of a study that nothing crosses."""
    if not studies:
        return Banner("plain", _NONE, "No gauge study", "bias alone is shown; what is missing is named below")
    reason = f"Cg or Cgk is below {CAPABLE:g} in {sum(one.capable is False for one in studies)} of {len(studies)}"
    reason += "; sensors and stations are not crossed"
    if any(one.capable is False for one in studies):
        return Banner("fail", "✗", "Not capable by the type 1 study", reason)
    if all(one.capable for one in studies):
        return Banner("pass", "✓", "Capable by the type 1 study", reason)
    return Banner("marginal", "≈", "Capability is not shown by the type 1 study", reason)


def _blocks(metric: MetricGauge, study: GaugeStudy) -> Iterator[Block]:
    if metric.anova is None:
        uneven = f"; uneven: {list_names(metric.missing)}" if metric.missing else ""
        yield Paragraph(f"No study: {metric.why}{uneven}.", "warning")
    else:
        yield from (Paragraph(text) for text in _sentences(metric, study))
        yield _figure(metric, study)
        yield _components(metric, study)
        yield _anova(metric, nested=study.nested is not None)
        if metric.missing:
            yield Paragraph(f"Uneven: {list_names(metric.missing)}.", "note")
    yield from (Paragraph(f"{capital(note)}.", "note") for note in metric.notes)
    if metric.references is not None:
        yield from list_reference_tables(metric.references, metric.unit, study)


def _sentences(metric: MetricGauge, study: GaugeStudy) -> Iterator[str]:
    assert metric.anova is not None
    gauge, interval = metric.anova.components.gauge, metric.anova.gauge_percent_contribution_interval
    yield _SHARE.format(
        contribution=_percent(gauge.percent_contribution),
        confidence=100 * study.confidence,
        low=_percent(interval.low),
        high=_percent(interval.high),
        study=_percent(gauge.percent_study),
        grade=_grade(gauge.percent_study),
    )
    if gauge.percent_tolerance is None:
        yield _NO_TOLERANCE
    else:
        ends = gauge.percent_tolerance_interval
        yield _TOLERANCE.format(
            share=_percent(gauge.percent_tolerance),
            inside=f" ({_percent(ends.low)} to {_percent(ends.high)})" if ends else "",
            of=metric.tolerance_of,
            width=_with_unit(metric.tolerance or 0.0, metric.unit),
            grade=_grade(gauge.percent_tolerance),
        )
    if metric.anova.categories is not None:
        count = plural(metric.anova.categories, "category", "categories")
        categories_range = _ends(metric.anova.categories_interval, 2)
        yield _CATEGORIES.format(count=count, of=_parts(study), inside=categories_range, least=_LEAST_CATEGORIES)
        yield _largest(metric, study.appraiser)
    yield from (f"{capital(note)}." for note in metric.anova.notes)


def _largest(metric: MetricGauge, appraiser: str) -> str:
    """Describe the largest part of the gauge's variance."""
    assert metric.anova is not None
    variance_by_cause = {
        "the scatter of repeated runs": metric.anova.components.repeatability.variance,
        f"differences between {appraiser}s": metric.anova.appraiser_variance,
        f"differences between {appraiser}s that depend on the sensor": metric.anova.interaction_variance or 0.0,
    }
    name, variance = max(variance_by_cause.items(), key=lambda part: part[1])
    share = _percent(100 * variance / metric.anova.components.gauge.variance)
    return _LARGEST.format(name=name, deviation=_with_unit(sqrt(variance), metric.unit), share=share)


def _figure(metric: MetricGauge, study: GaugeStudy) -> Figure:
    part = study.nested or "sensor"

    def draw() -> str:
        # loads matplotlib
        from cbsr_qa.studies.gauge.figures import draw_panels

        assert metric.crossing is not None
        assert metric.anova is not None
        return draw_panels(metric.crossing, metric.anova.components, metric.unit)

    caption = (
        f"Where the variation of {metric.title} comes from: shares of the components; every run by {part} and by "
        f"{study.appraiser}, with means; ranges of repeated runs, where a point beyond the limit repeats worse than "
        f"the rest; means against limits of repeatability, most of which lie outside where the gauge tells "
        f"{_parts(study)} apart"
    )
    if study.nested is None:
        caption += f"; and means of each sensor by {study.appraiser}, whose lines cross where there is an interaction"
    return Figure(f"{caption}.", f"Panels of the gauge study of {metric.title}; the table has the components.", draw)


def _parts(study: GaugeStudy) -> str:
    return "batches" if study.nested == "batch" else "sensors"


def _components(metric: MetricGauge, study: GaugeStudy) -> Table:
    assert metric.anova is not None
    rows: list[tuple[str, ...]] = []
    for label, name in _PARTS:
        component = getattr(metric.anova.components, name)
        interval = component.variance_interval
        row: tuple[str, ...] = (
            _parts(study) if name == "sensor" else label,
            number(component.deviation),
            _ends(Interval(sqrt(interval.low), sqrt(interval.high), interval.confidence)) if interval else _NONE,
            _percent(component.percent_contribution),
            _percent(component.percent_study),
            _NONE if component.percent_tolerance is None else _percent(component.percent_tolerance),
        )
        if metric.average_range is not None:
            row += (number(getattr(metric.average_range.components, name).deviation),)
        rows.append(row)
    columns = (
        "component",
        unit_column("standard deviation", metric.unit),
        f"{100 * study.confidence:g} % interval",
        "of variance",
        "of study variation",
        "of tolerance",
        *(["by ranges"] if metric.average_range is not None else []),
    )
    return text_table("Components of variation.", columns, rows, range(1, len(columns)))


def _anova(metric: MetricGauge, *, nested: bool) -> Table:
    assert metric.anova is not None
    rows = [
        (
            row.source,
            str(row.degrees_of_freedom),
            number(row.sum_of_squares),
            number(row.mean_square),
            _NONE if row.f is None else number(row.f),
            _NONE if row.p is None else number(row.p, 2),
        )
        for row in metric.anova.table
    ]
    pooled = "pooled into repeatability" if metric.anova.interaction_pooled else "kept"
    caption = "Nested analysis of variance." if nested else f"Analysis of variance; the interaction is {pooled}."
    columns = ("source", "degrees of freedom", "sum of squares", "mean square", "F", "p")
    return replace(text_table(caption, columns, rows, range(1, 6)), folded=True)


def _ends(interval: Interval, digits: int = 3) -> str:
    ends = (interval.low, interval.high)
    return " to ".join(number(end, digits) if abs(end) < float("inf") else "any" for end in ends)


def _grade(percent: float) -> str:
    if percent < _GOOD_PERCENT:
        return f"good (below {_GOOD_PERCENT:g} %)"
    if percent <= _POOR_PERCENT:
        return f"acceptable for some uses ({_GOOD_PERCENT:g} to {_POOR_PERCENT:g} %)"
    return f"not good enough (above {_POOR_PERCENT:g} %)"


def _percent(value: float) -> str:
    return f"{format_fixed(value, 1)} %" if value < 10 else f"{format_fixed(value, 0)} %"


def _with_unit(value: float, unit: str) -> str:
    return f"{number(value)} {unit_shown(unit)}".rstrip()
