"""How a gauge stands to reference values: sentences for a terminal, tables for a page, of the same verdicts.

What a gauge study says, in sentences for a page and a terminal.
"""

from collections.abc import Iterable, Iterator
from datetime import date
from math import sqrt
from typing import TYPE_CHECKING, Final

from cbsr_qa.domain.results import Table
from cbsr_qa.report import fixed, number, plural, text_table, unit_column, unit_shown, with_uncertainty
from cbsr_qa.stats import Interval, Referenced
from cbsr_qa.stats.gauge import FEWEST_CHARTED, Linearity, Source, Stability, on
from cbsr_qa.studies.gauge.references import AgainstReferences, BiasLine, LinearityLine, ReferenceValue, StabilityLine

if TYPE_CHECKING:
    from cbsr_qa.stats.gauge import Variance, Variation
    from cbsr_qa.studies.gauge.request import StudySource
    from cbsr_qa.studies.gauge.study import Gauge, MetricGauge


#: AIAG's bands for the gauge's share of the total deviation or of the tolerance [%], and for categories.
GOOD_PERCENT: Final = 10.0
POOR_PERCENT: Final = 30.0
LEAST_CATEGORIES: Final = 5


def verdict_words(percent: float) -> str:
    """Grade a share of deviation as AIAG does."""
    if percent < GOOD_PERCENT:
        return f"below {GOOD_PERCENT:g} %: good"
    if percent <= POOR_PERCENT:
        return f"between {GOOD_PERCENT:g} and {POOR_PERCENT:g} %: may be good enough, depending on the use"
    return f"above {POOR_PERCENT:g} %: not good enough"


def study_words(found: "Gauge") -> str:
    """Say what the study is of, in one line."""
    request = found.request
    sensors, appraisers = found.sensors(), found.appraisers()
    words = f"{plural(len(sensors), 'sensor')} by {plural(len(appraisers), request.appraiser)} "
    words += f"({', '.join(appraisers)}), {plural(len(found.runs), 'run')} of recipe {found.runs[0].recipe}"
    if request.since or request.until:
        words += f", {period_words(request.since, request.until)}"
    return f"{words} (SIMULATED)" if found.simulated else words


def source_words(source: "StudySource") -> str:
    """Say which file a study was read from, with its digest."""
    return f"{source.name} ({source.file}, SHA-256 {source.sha256})"


def period_words(since: date | None, until: date | None) -> str:
    """Say from and to which day, both included; empty where neither is stated."""
    ends = [f"from {since}"] if since else []
    ends += [f"to {until}"] if until else []
    return f"{' '.join(ends)} (UTC)" if ends else ""


def metric_words(one: "MetricGauge", appraiser: str, confidence: float) -> tuple[str, ...]:
    """Say what one metric's study came to, most important first."""
    if one.study is None or one.anova is None or one.ranges is None:
        lacking = f"; uneven: {listed(one.missing)}" if one.missing else ""
        return (f"No study: {one.why}{lacking}.",)
    variation = one.anova.variation
    said = [_share_words(variation, one.anova.gauge_share, confidence)]
    said.append(_tolerance_words(one, variation))
    said.append(_category_words(variation, one.anova.categories))
    said.append(_largest_words(one, appraiser))
    said += [f"{note[0].upper()}{note[1:]}." for note in (*variation.notes, *one.notes)]
    return tuple(words for words in said if words)


def listed(names: "tuple[str, ...]", most: int = 6) -> str:
    """List names; of very many the first ones."""
    rest = len(names) - most
    return "; ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def source_of_variation(source: Source, appraiser: str) -> str:
    """Return a row of the analysis of variance, who appraised by the right name."""
    return str(source).replace(str(Source.STATION), appraiser)


def interval_words(interval: Interval | None, digits: int = 3) -> str:
    """Write both ends, ``0.12 to 0.45``; empty where there is none."""
    if interval is None:
        return ""
    low, high = (number(end, digits) if abs(end) < float("inf") else "any" for end in (interval.low, interval.high))
    return f"{low} to {high}"


def deviation_words(part: "Variance") -> str:
    """Write the interval of a component's deviation; a dash where it has none."""
    if part.interval is None:
        return "–"
    return interval_words(Interval(sqrt(part.interval.low), sqrt(part.interval.high), part.interval.confidence))


def percent(value: float) -> str:
    """Write a per cent value as a reader needs it."""
    return f"{fixed(value, 1)} %" if value < 10 else f"{fixed(value, 0)} %"


def _share_words(variation: "Variation", interval: Interval, confidence: float) -> str:
    gauge = variation.gauge
    study = variation.percent_study(gauge)
    contribution = variation.percent_contribution(gauge)
    low, high = (percent(100 * end) for end in (interval.low, interval.high))
    return (
        f"The gauge makes {percent(contribution)} of the variance of these runs ({100 * confidence:g} % interval "
        f"{low} to {high}), which is {percent(study)} of their deviation, {verdict_words(study)}."
    )


def _tolerance_words(one: "MetricGauge", variation: "Variation") -> str:
    share = variation.percent_tolerance(variation.gauge)
    if share is None:
        ends = sum(end is not None for end in (one.series.lower, one.series.upper))
        limits = ("no limits", "one limit", "limits that meet")[ends]
        return f"The recipe sets it {limits}, so that there is no tolerance to take a share of."
    interval = variation.tolerance_interval(variation.gauge)
    inside = f" ({percent(interval.low)} to {percent(interval.high)})" if interval else ""
    width = f"{number(one.tolerance or 0.0)} {unit_shown(one.series.unit)}".rstrip()
    return (
        f"Six deviations of the gauge are {percent(share)} of the {one.tolerance_of}'s tolerance of {width}{inside}, "
        f"{verdict_words(share)}."
    )


def _category_words(variation: "Variation", interval: Interval) -> str:
    if variation.gauge.value == 0:
        return ""
    enough = "enough" if variation.categories >= LEAST_CATEGORIES else f"fewer than the {LEAST_CATEGORIES} asked for"
    return (
        f"It tells {plural(variation.categories, 'category', 'categories')} of sensors apart (interval "
        f"{interval_words(interval, 2)}), "
        f"{enough}."
    )


def _largest_words(one: "MetricGauge", appraiser: str) -> str:
    """Say where most of the gauge's variance is."""
    anova, variation = one.anova, one.anova.variation if one.anova else None
    if anova is None or variation is None or variation.gauge.value == 0:
        return ""
    parts = {
        "repeated runs of one sensor": variation.repeatability.value,
        f"differences between {appraiser}s": anova.station.value,
        f"differences between {appraiser}s that go with the sensor": anova.interaction.value
        if anova.interaction
        else 0.0,
    }
    name, value = max(parts.items(), key=lambda part: part[1])
    unit = unit_shown(one.series.unit)
    size = f"{number(value**0.5)} {unit}".rstrip()
    return (
        f"Most of it are {name} (deviation {size}, {percent(100 * value / variation.gauge.value)} of its variance)."
    )


_NONE: Final = "–"


def reference_words(found: AgainstReferences, appraiser: str, confidence: float) -> Iterator[str]:
    """Say how the gauge stands to reference values, which are in the metric's unit."""
    by = on(appraiser)
    unit = f" {unit_shown(found.unit)}".rstrip()
    for one in found.biases:
        where = f"{one.reference.serial} {by} {one.appraiser}" if one.appraiser else one.reference.serial
        if one.bias is None:
            yield f"Bias of {where}: not known: {one.why}."
            continue
        inside = interval_words(one.bias.interval(confidence))
        yield (
            f"Bias of {where}: {number(one.bias.value)}{unit} ({inside}) against "
            f"{_reference(one.reference)}{unit} in {plural(one.count, 'run')}: {_bias_says(one.bias, confidence)}."
        )
    yield from _linearity_words(found, by, unit, confidence)
    yield from _stability_words(found, by, unit, confidence)


def reference_tables(found: AgainstReferences, appraiser: str, confidence: float) -> Iterator[Table]:
    """Lay out the same as up to three tables: bias, linearity, stability."""
    sure = f"{100 * confidence:g} % interval"
    head: tuple[str, ...]
    columns = ("sensor", appraiser, unit_column("reference", found.unit), "runs")
    if found.biases:
        rows = [_bias_row(one, confidence) for one in found.biases]
        head = (*columns, unit_column("bias", found.unit), sure, "p", "says")
        yield text_table(f"Bias against reference values{_whys(found.biases)}.", head, rows, (2, 3, 4, 5, 6))
    if found.linearity:
        rows = [_linearity_row(one, confidence) for one in found.linearity]
        head = (appraiser, "slope of the bias", sure, "with the value", "over the references")
        yield text_table(f"Linearity of the bias{_whys(found.linearity)}.", head, rows, (1, 2))
    if found.stability:
        rows = [_stability_row(one, confidence) for one in found.stability]
        head = ("sensor", appraiser, unit_column("drift a day", found.unit), sure, "its chart")
        yield text_table(f"Stability over time{_whys(found.stability)}.", head, rows, (2, 3))


def _reference(one: ReferenceValue) -> str:
    return with_uncertainty(one.value, one.uncertainty)


def _whys(lines: Iterable[BiasLine | LinearityLine | StabilityLine]) -> str:
    """Say once why some are not known: of many rows it is the same reason."""
    whys = tuple(dict.fromkeys(one.why for one in lines if one.why))
    return f"; a dash is not known: {listed(whys)}" if whys else ""


def _bias_row(one: BiasLine, confidence: float) -> tuple[str, ...]:
    said = (one.reference.serial, one.appraiser or _NONE, _reference(one.reference), str(one.count))
    if one.bias is None:
        return *said, _NONE, _NONE, _NONE, _NONE
    inside = interval_words(one.bias.interval(confidence))
    return *said, number(one.bias.value), inside, number(one.bias.p_value(), 2), _bias_says(one.bias, confidence)


def _linearity_row(one: LinearityLine, confidence: float) -> tuple[str, ...]:
    if one.linearity is None:
        return one.appraiser, _NONE, _NONE, _NONE, _NONE
    slope = one.linearity.rise()
    inside = interval_words(slope.interval(confidence))
    return (
        one.appraiser,
        number(slope.value),
        inside,
        _slope_says(one.linearity, confidence),
        _line_says(one.linearity, confidence),
    )


def _stability_row(one: StabilityLine, confidence: float) -> tuple[str, ...]:
    if one.stability is None:
        return one.reference.serial, one.appraiser, _NONE, _NONE, _NONE
    drift = one.stability.drift
    inside = interval_words(drift.interval(confidence))
    return one.reference.serial, one.appraiser, number(drift.value), inside, _chart_says(one.stability)


def _bias_says(found: Referenced, confidence: float) -> str:
    return "no bias is seen" if found.interval(confidence).holds(0.0) else "biased"


def _slope_says(found: Linearity, confidence: float) -> str:
    level = found.rise().interval(confidence).holds(0.0)
    return "no change of the bias with the value is seen" if level else "the bias goes with the value"


def _line_says(found: Linearity, confidence: float) -> str:
    return "no bias is seen" if found.acceptable(confidence) else "there is a bias somewhere"


def _chart_says(found: Stability) -> str:
    count = len(found.chart.points)
    if count < FEWEST_CHARTED:
        return f"{count} runs are too few for a chart to say anything ({FEWEST_CHARTED} at least)"
    return f"signals: {found.chart.signals[0].rule}" if found.chart.signals else "gives no signal"


def _linearity_words(found: AgainstReferences, by: str, unit: str, confidence: float) -> Iterator[str]:
    """Say of each appraiser whether the bias goes with the value, and whether there is any over the references."""
    unknown: dict[str, list[str]] = {}
    for one in found.linearity:
        if one.linearity is None:
            unknown.setdefault(one.why, []).append(one.appraiser)
            continue
        slope, references = one.linearity.rise(), one.linearity.references
        yield (
            f"Linearity {by} {one.appraiser}: slope of the bias {number(slope.value)} "
            f"({interval_words(slope.interval(confidence))}): {_slope_says(one.linearity, confidence)}; over the "
            f"references, {number(references[0])} to {number(references[-1])}{unit}, "
            f"{_line_says(one.linearity, confidence)}."
        )
    for why, names in unknown.items():
        yield f"Linearity {by} {listed(tuple(names))}: not known: {why}."


def _stability_words(found: AgainstReferences, by: str, unit: str, confidence: float) -> Iterator[str]:
    """Say of each reference and appraiser what it drifts, and what its chart says where it can say anything."""
    unknown: dict[str, list[str]] = {}
    for one in found.stability:
        where = f"{one.reference.serial} {by} {one.appraiser}"
        if one.stability is None:
            unknown.setdefault(one.why, []).append(where)
            continue
        drift, said = one.stability.drift, _chart_says(one.stability)
        its = said if one.stability.in_control is None else f"its chart {said}"
        inside = interval_words(drift.interval(confidence))
        yield f"Stability of {where}: drift {number(drift.value)}{unit} a day ({inside}); {its}."
    for why, names in unknown.items():
        yield f"Stability of {listed(tuple(names))}: not known: {why}."
