"""What a gauge study says, in sentences for a page and a terminal."""

from datetime import date
from math import sqrt
from typing import TYPE_CHECKING, Final

from cbsr_qa.report.numbers import fixed, number, plural, unit_shown
from cbsr_qa.stats.gauge_anova import Source
from cbsr_qa.stats.samples import Interval

if TYPE_CHECKING:
    from cbsr_qa.app.gauge import Gauge, MetricGauge
    from cbsr_qa.app.gauge_request import StudySource
    from cbsr_qa.stats.gauge_study import Variance, Variation

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
