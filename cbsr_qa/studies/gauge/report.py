"""What a person reads of a gauge study: one section per metric, with grades, tables and the six panels."""

from collections.abc import Callable, Iterator, Sequence
from math import sqrt
from typing import Final, TypeVar

from cbsr_qa.domain.results import Banner, Block, CommandOutcome, Figure, Page, Paragraph, Section, Table
from cbsr_qa.report import fixed, named, number, plural, text_table, unit_column, unit_shown, with_uncertainty
from cbsr_qa.stats import Estimate, Interval
from cbsr_qa.stats.gauge import FEWEST_CHARTED
from cbsr_qa.studies.gauge.references import AgainstReferences, Bias, BiasLinearity, BiasStability
from cbsr_qa.studies.gauge.study import GaugeStudy, MetricGauge

#: AIAG's bands for the gauge's share of the total deviation or of the tolerance [%], and for categories.
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

_READING: Final = (
    "Sensors differ, and so do measurements of one sensor: from run to run (repeatability), and from one station or "
    "operator to another (reproducibility). Both together are the gauge. A gauge that varies as much as the sensors "
    "cannot tell them apart; one that varies as much as the limits are wide passes and fails sensors by chance.",
    "Each value is the mean over the loads of a run. Components come from an analysis of variance with random "
    "effects; an interaction of sensor and station with p above 0.25 is pooled into repeatability. The column "
    "'by ranges' uses the older method of averages and ranges, which ignores the interaction and has no intervals. "
    "Both follow AIAG, Measurement Systems Analysis, 4th edition. Its bands are: good below "
    f"{_GOOD_PERCENT:g} %, not good enough above {_POOR_PERCENT:g} % of deviation or tolerance, and at least "
    f"{_LEAST_CATEGORIES} distinct categories.",
)

# Sentences, in the order they are read.
_SHARE: Final = (
    "The gauge accounts for {contribution} of the variance ({confidence:g} % interval {low} to {high}) and {study} "
    "of the deviation: {grade}."
)
_TOLERANCE: Final = "Six deviations of the gauge take {share}{inside} of the {of}'s tolerance of {width}: {grade}."
_NO_TOLERANCE: Final = "Without a lower and an upper limit there is no tolerance to compare the gauge with."
_CATEGORIES: Final = "It distinguishes {count} of sensors (interval {inside}); at least {least} are needed."
_LARGEST: Final = "The largest part is {name}: deviation {deviation}, {share} of the gauge's variance."


def gauge_outcome(found: GaugeStudy) -> CommandOutcome[GaugeStudy]:
    """Lay a study out."""
    sections = [Section("How to read this page", tuple(map(Paragraph, _READING)), page_only=True)]
    sections += [Section(one.label, tuple(_blocks(one, found))) for one in found.metrics]
    return CommandOutcome(found, _page(found), tuple(sections))


def _page(found: GaugeStudy) -> Page:
    facts = [("Recipe", found.recipe), ("Sensors", f"{len(found.sensors)} ({named(found.sensors)})")]
    if found.study is not None:
        facts.insert(0, ("Study", f"{found.study.name} ({found.study.file}, SHA-256 {found.study.sha256})"))
    facts.append((f"{found.appraiser.capitalize()}s", ", ".join(found.appraisers)))
    facts.append(("Runs", str(len(found.runs))))
    days = [f"{word} {day}" for word, day in (("from", found.since), ("to", found.until)) if day]
    facts += [("Period", f"{' '.join(days)} (UTC)")] if days else []
    subject = f"{plural(len(found.sensors), 'sensor')} by {plural(len(found.appraisers), found.appraiser)}"
    simulated = ("the runs of this study",) if found.simulated else ()
    return Page("Gauge study", subject, _banner(found), tuple(facts), simulated, found.notes)


def _banner(found: GaugeStudy) -> Banner:
    shares = [(one.anova.components.gauge.percent_study, one.label) for one in found.metrics if one.anova]
    if not shares:
        return Banner("plain", _NONE, "No gauge study", "bias alone is shown; what is missing is named below")
    share, label = max(shares)
    tone, symbol = ("pass", "✓") if share < _GOOD_PERCENT else ("marginal", "≈")
    if share > _POOR_PERCENT:
        tone, symbol = "fail", "✗"
    of = f"{label} is the worst of {plural(len(shares), 'metric')}" if len(shares) > 1 else label
    return Banner(tone, symbol, f"The gauge makes up {_percent(share)} of the deviation", f"{of}: {_grade(share)}")


def _blocks(one: MetricGauge, found: GaugeStudy) -> Iterator[Block]:
    if one.anova is None:
        uneven = f"; uneven: {named(one.missing)}" if one.missing else ""
        yield Paragraph(f"No study: {one.why}{uneven}.", "warning")
    else:
        yield from (Paragraph(text) for text in _sentences(one, found))
        yield _figure(one, found.appraiser)
        yield _components(one, found.confidence)
        yield _anova(one)
        if one.missing:
            yield Paragraph(f"Uneven: {named(one.missing)}.", "note")
    yield from (Paragraph(f"{note[0].upper()}{note[1:]}.", "note") for note in one.notes)
    if one.references is not None:
        yield from _reference_tables(one.references, one.unit, found)


def _sentences(one: MetricGauge, found: GaugeStudy) -> Iterator[str]:
    assert one.anova is not None
    gauge, inside = one.anova.components.gauge, one.anova.gauge_percent_contribution_interval
    yield _SHARE.format(
        contribution=_percent(gauge.percent_contribution),
        confidence=100 * found.confidence,
        low=_percent(inside.low),
        high=_percent(inside.high),
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
            of=one.tolerance_of,
            width=_with_unit(one.tolerance or 0.0, one.unit),
            grade=_grade(gauge.percent_tolerance),
        )
    if one.anova.categories is not None:
        count = plural(one.anova.categories, "category", "categories")
        inside_of = _ends(one.anova.categories_interval, 2)
        yield _CATEGORIES.format(count=count, inside=inside_of, least=_LEAST_CATEGORIES)
        yield _largest(one, found.appraiser)
    yield from (f"{note[0].upper()}{note[1:]}." for note in one.anova.notes)


def _largest(one: MetricGauge, appraiser: str) -> str:
    """Say where most of the gauge's variance comes from."""
    assert one.anova is not None
    parts = {
        "the scatter of repeated runs": one.anova.components.repeatability.variance,
        f"differences between {appraiser}s": one.anova.appraiser_variance,
        f"differences between {appraiser}s that depend on the sensor": one.anova.interaction_variance or 0.0,
    }
    name, variance = max(parts.items(), key=lambda part: part[1])
    share = _percent(100 * variance / one.anova.components.gauge.variance)
    return _LARGEST.format(name=name, deviation=_with_unit(sqrt(variance), one.unit), share=share)


def _figure(one: MetricGauge, appraiser: str) -> Figure:
    def draw() -> str:
        # matplotlib is loaded only where something is drawn
        from cbsr_qa.studies.gauge.figures import six_panels

        assert one.crossing is not None
        assert one.anova is not None
        return six_panels(one.crossing, one.anova.components, one.unit)

    caption = (
        f"Where the variation of {one.label} comes from: shares of the components; every run by sensor and by "
        f"{appraiser}, with means; ranges of repeated runs, where a point beyond the limit repeats worse than the "
        "rest; means against limits of repeatability, most of which lie outside where the gauge tells sensors apart; "
        f"and means of each sensor by {appraiser}, whose lines cross where there is an interaction."
    )
    return Figure(caption, f"Six panels of the gauge study of {one.label}; the table has the components.", draw)


def _components(one: MetricGauge, confidence: float) -> Table:
    assert one.anova is not None
    assert one.average_range is not None
    rows = []
    for shown, name in _PARTS:
        part = getattr(one.anova.components, name)
        inside = part.variance_interval
        rows.append(
            (
                shown,
                number(part.deviation),
                _ends(Interval(sqrt(inside.low), sqrt(inside.high), inside.confidence)) if inside else _NONE,
                _percent(part.percent_contribution),
                _percent(part.percent_study),
                _NONE if part.percent_tolerance is None else _percent(part.percent_tolerance),
                number(getattr(one.average_range.components, name).deviation),
            )
        )
    of = ("of variance", "of deviation", "of tolerance", "by ranges")
    columns = ("component", unit_column("deviation", one.unit), f"{100 * confidence:g} % interval", *of)
    return text_table("Components of variation.", columns, rows, range(1, 7))


def _anova(one: MetricGauge) -> Table:
    assert one.anova is not None
    rows = [
        (
            row.source,
            str(row.degrees_of_freedom),
            number(row.sum_of_squares),
            number(row.mean_square),
            _NONE if row.f is None else number(row.f),
            _NONE if row.p is None else number(row.p, 2),
        )
        for row in one.anova.table
    ]
    pooled = "pooled into repeatability" if one.anova.interaction_pooled else "kept"
    columns = ("source", "degrees of freedom", "sum of squares", "mean square", "F", "p")
    table = text_table(f"Analysis of variance; the interaction is {pooled}.", columns, rows, range(1, 6))
    return Table(table.caption, table.columns, table.rows, table.numeric, folded=True)


def _reference_tables(found: AgainstReferences, unit: str, of: GaugeStudy) -> Iterator[Table]:
    sure, who = f"{100 * of.confidence:g} % interval", of.appraiser
    columns: tuple[str, ...] = ("sensor", who, unit_column("reference", unit), "runs")
    columns += (unit_column("bias", unit), sure, "p", "result")
    yield from _table("Bias against reference values", columns, found.bias, _bias, range(2, 7))
    columns = (who, "slope of the bias", sure, unit_column("references", unit), "bias depends on value", "bias")
    yield from _table("Linearity of the bias", columns, found.linearity, _linearity, range(1, 4))
    columns = ("sensor", who, unit_column("drift per day", unit), sure, "control chart")
    yield from _table("Stability over time", columns, found.stability, _stability, range(2, 4))


_Row = TypeVar("_Row", Bias, BiasLinearity, BiasStability)


def _table(
    what: str,
    columns: tuple[str, ...],
    rows: Sequence[_Row],
    cells: Callable[[_Row], tuple[str, ...]],
    numeric: range,
) -> Iterator[Table]:
    """Lay rows out, if there are any; for many rows that are unknown the reason is the same, and stands once."""
    whys = tuple(dict.fromkeys(one.why for one in rows if one.why))
    caption = f"{what}; {_NONE}: {named(whys)}." if whys else f"{what}."
    if rows:
        yield text_table(caption, columns, [cells(one) for one in rows], numeric)


def _bias(one: Bias) -> tuple[str, ...]:
    reference = with_uncertainty(one.reference, one.uncertainty)
    known = (one.serial, one.appraiser or _NONE, reference, str(one.runs))
    if one.bias is None:
        return *known, *[_NONE] * 4
    return (
        *known,
        *_estimated(one.bias),
        number(one.bias.p, 2),
        "not significant" if one.bias.holds_zero else "biased",
    )


def _linearity(one: BiasLinearity) -> tuple[str, ...]:
    if one.slope is None or one.references is None:
        return one.appraiser, *[_NONE] * 5
    ends = " to ".join(map(number, one.references))
    depends = "not significant" if one.slope.holds_zero else "yes"
    return one.appraiser, *_estimated(one.slope), ends, depends, "not significant" if one.acceptable else "yes"


def _stability(one: BiasStability) -> tuple[str, ...]:
    if one.drift_per_day is None:
        return one.serial, one.appraiser, *[_NONE] * 3
    chart = f"fewer than {FEWEST_CHARTED} runs" if one.in_control is None else one.signal or "in control"
    return one.serial, one.appraiser, *_estimated(one.drift_per_day), chart


def _estimated(one: Estimate) -> tuple[str, str]:
    return number(one.value), f"{number(one.low)} to {number(one.high)}"


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
    return f"{fixed(value, 1)} %" if value < 10 else f"{fixed(value, 0)} %"


def _with_unit(value: float, unit: str) -> str:
    return f"{number(value)} {unit_shown(unit)}".rstrip()
