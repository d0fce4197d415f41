"""Report of a comparison: which groups differ and by how much, and cautions."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, prefix_kind
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Page, Paragraph, Section
from cbsr_qa.report.tables import capital, list_names, number, plural
from cbsr_qa.studies.compare.comparison import Comparison, MetricComparison
from cbsr_qa.studies.compare.differences import Estimated
from cbsr_qa.studies.compare.tables import amount, sections
from cbsr_qa.studies.compare.terms import By

_NOTHING: Final = 3
_MAX_IN_HEADLINE: Final = 2
_MAX_DIGITS: Final = 9
_NONE: Final = "–"
_COMPARED: Final = "by {by}, with {reference} as reference"
_RUNS: Final = "{runs} of {sensors} at {stations}, recipe {recipes}"
_NO_COMPARISON: Final = "{groups}: nothing could be compared"
_READS: Final = "{who} reads {size} ({low} to {high}) {side} {reference}{metric}{where}"
#: What a difference was compared within, so that it is not another one.
_WITHIN: Final = {
    "stations": " at the same stations",
    "batches": " in the same batches",
    "groups": " in the same groups",
}
_MORE: Final = "{count} in the tables"
_NONE_SHOWN: Final = "{groups}: no difference shown in {metrics}"
_NOT_SHOWN: Final = "{groups}: no difference from {reference} shown"
_NEVER: Final = "{groups} cannot be compared"
_IN_SOME: Final = "{groups} could not be compared in {count} of {metrics}"
_NO_VALUES: Final = "Nothing was measured: no run that counts holds a measurement."
_REFUSED: Final = "{metrics} not compared: {text}."
_CONSTANT: Final = "{metric}: all sensors of each group read the same ({values}), so no test is possible."
_T_TEST: Final = (
    "A t test, which ignores {others} and the number of metrics, claims differences that the model does not find: "
    "{claims}."
)
_NOT_ALIKE: Final = "No difference shown does not prove groups alike: --margin METRIC=VALUE tests for that."
_NOTE: Final = "{metrics}: {text}."
_RULES: Final = (
    "Yield counts one finished run per sensor (--policy {policy}); first-pass yield counts the first.",
    "Sensors that could not be measured count apart from yields, or as failed (--quarantine {quarantine}).",
    "Yields, means, quantiles and capability are those of values as measured, not adjusted for stations. A"
    " verdict that was overridden (cbsr-qa verdict override) counts as it was overridden, its values as measured.",
    "Each interval has a confidence of {confidence:g} %. p values (--adjust {adjustment}) are adjusted over all"
    " metrics and groups, separately for differences, stations and equivalence; those of places by Holm.",
    "If a metric has one value per load, the value of a sensor is their mean over the loads of its recipe;"
    " capability uses the load nearest to the limit, which decides the verdict.",
)
_RULE_OF_NUMBERS: Final = (
    "Two one-sided tests decide whether groups are alike within a margin. Numbers of sensors are those in each"
    " group, all {where} and run once, with which one test at the level {level:g} succeeds with {power:g} %;"
    " adjusting for many tests takes more."
)


def compare_outcome(comparison: Comparison) -> CommandOutcome[Comparison]:
    """Lay a comparison out; its headline, sentences and rules are filled in."""
    warnings, advice, notes = tuple(_important(comparison)), tuple(_advice(comparison)), tuple(_notes(comparison))
    worded = replace(
        comparison,
        headline=_headline(comparison),
        sentences=(*warnings, *advice, *notes, *comparison.warnings),
        rules=tuple(_rules(comparison)),
    )
    identity = (
        ("Compared", _COMPARED.format(by=comparison.by, reference=comparison.reference)),
        (
            "Runs",
            _RUNS.format(
                runs=plural(sum(group.runs for group in comparison.groups), "run"),
                sensors=plural(sum(group.n for group in comparison.groups), "sensor"),
                stations=", ".join(comparison.all_stations),
                recipes=", ".join(comparison.recipes),
            ),
        ),
    )
    banner = Banner("plain", "●" if comparison.compared else _NONE, worded.headline, "")
    subject, all_warnings = f"by {comparison.by}", (*warnings, *comparison.warnings)
    page = Page("Comparison", subject, banner, identity, comparison.simulated, all_warnings, advice)
    laid_out = list(sections(worded))
    if notes:  # they change no decision
        laid_out.append(Section("Notes", tuple(map(Paragraph, notes)), page_only=True))
    return CommandOutcome(worded, page, tuple(laid_out), 0 if comparison.compared else _NOTHING)


def _headline(comparison: Comparison) -> str:
    """Answer in two sentences: which groups differ, and which station, each with the other taken out."""
    group_names = [group.name for group in comparison.groups]
    if not comparison.compared:
        return _NO_COMPARISON.format(groups=_join_groups(group_names))
    significant_pairs = sorted(
        ((metric, difference) for metric, difference in comparison.pairs if comparison.significant(difference)),
        key=lambda pair: -abs(pair[1].effect_size or 0.0),
    )
    has_kind = comparison.by in (By.BATCH, By.MATERIAL, By.STATION)
    readings: list[tuple[MetricComparison, Estimated, str]] = []
    for metric, difference in significant_pairs[:_MAX_IN_HEADLINE]:
        group = str(difference.group)
        readings.append((metric, difference, prefix_kind(str(comparison.by), group) if has_kind else group))
    titles = {metric.values.title for metric, *_ in readings}
    stations = [(metric, station) for metric in comparison.of_metrics for station in metric.stations]
    deviating_stations = sorted(
        (pair for pair in stations if comparison.significant(pair[1])),
        key=lambda pair: (pair[0].values.title not in titles, pair[1].p),
    )
    within_stations = "".join(_WITHIN[factor] for factor in _list_factors(comparison))
    of_groups = [
        *_readings(readings, comparison, within_stations),
        *_say_alike({difference_found.group for _, difference_found in significant_pairs}, comparison),
        *_say_missing(comparison),
    ]
    shown_station = [
        (metric, difference, prefix_kind("station", difference.station))
        for metric, difference in deviating_stations[:1]
    ]
    in_batches = comparison.by is By.BATCH or len(comparison.all_batches) > 1
    of_stations = list(_readings(shown_station, comparison, _WITHIN["batches" if in_batches else "groups"]))
    unlisted_count = len(significant_pairs) + len(deviating_stations) - len(readings) - len(shown_station)
    if unlisted_count:
        (of_stations or of_groups).append(_MORE.format(count=plural(unlisted_count, "more difference")))
    first, second = "; ".join(of_groups), "; ".join(of_stations)
    first = first if first.startswith(tuple(group_names)) else capital(first)
    second = second if second.startswith(tuple(comparison.all_stations)) else capital(second)
    return f"{first}. {second}." if second else first


def _list_factors(comparison: Comparison) -> list[str]:
    """Factors with several levels that the groups were compared within."""
    levels = {"stations": comparison.all_stations, "batches": comparison.all_batches}
    return [factor for factor in comparison.others.split(" and ") if len(levels[factor]) > 1]


def _readings(
    shown: Sequence[tuple[MetricComparison, Estimated, str]], comparison: Comparison, within: str
) -> Iterator[str]:
    """State differences from the reference; the metric is named when it changes."""
    previous_title = ""
    for metric, difference, group_words in shown:
        size, low, high = (difference.difference or 0.0, difference.low or 0.0, difference.high or 0.0)
        if size < 0:
            size, low, high = -size, -high, -low
        yield _READS.format(
            who=group_words,
            size=amount(size, metric.values.unit, 2),
            low=number(low, 2),
            high=number(high, 2),
            side=comparison.side(metric, difference),
            reference=difference.reference,
            metric="" if metric.values.title == previous_title else f" in {metric.values.title}",
            where=within,
        )
        previous_title = metric.values.title


def _say_alike(differ: Collection[str | None], comparison: Comparison) -> Iterator[str]:
    same = [name for name in _comparable_groups(comparison) if name not in differ and name != comparison.reference]
    if differ and same:
        yield _NOT_SHOWN.format(groups=_join_groups(same), reference=comparison.reference)
    elif same:
        tested = [
            m.values.title for m in comparison.of_metrics if any(difference.known for difference in m.differences)
        ]
        metrics = tested[0] if len(tested) == 1 else f"any of {len(tested)} metrics"
        yield _NONE_SHOWN.format(groups=_join_groups(_comparable_groups(comparison)), metrics=metrics)


def _say_missing(comparison: Comparison) -> Iterator[str]:
    """List groups that could not be compared, in all or some metrics, except metrics in which nothing differs."""
    metrics = [metric for metric in comparison.of_metrics if metric.differences and not _is_idle(metric)]
    counts = Counter(
        difference.group for metric in metrics for difference in metric.differences if not difference.known
    )
    names = [group.name for group in comparison.groups[1:] if counts[group.name]]
    never = [name for name in names if name not in _comparable_groups(comparison)]
    if never:
        yield _NEVER.format(groups=_join_groups(never))
    partly_compared = sorted((name for name in names if name not in never), key=lambda name: -counts[name])
    for count, members in groupby(partly_compared, key=lambda name: counts[name]):
        metrics_text = plural(len(metrics), "metric")
        yield _IN_SOME.format(groups=_join_groups(list(members)), count=count, metrics=metrics_text)


def _important(comparison: Comparison) -> Iterator[str]:
    """Return what may change a decision: missing comparisons and their reasons."""
    if not comparison.of_metrics:
        yield _NO_VALUES
    yield from _refusals(comparison, of_idle=False)
    for metric in comparison.of_metrics:
        read = _constant(metric)
        if read:
            yield _CONSTANT.format(metric=capital(metric.values.title), values=list_names(read, 8))


def _advice(comparison: Comparison) -> Iterator[str]:
    if (
        comparison.compared
        and not comparison.terms.margins
        and not all(comparison.significant(difference) for _, difference in comparison.pairs)
    ):
        yield _NOT_ALIKE


def _notes(comparison: Comparison) -> Iterator[str]:
    """Return notes: results of a plain test, and each note once with its metrics."""
    claims = [
        f"{pair.group} − {pair.reference} in {metric.values.title} "
        f"({amount(pair.naive.difference, metric.values.unit)})"
        for metric, pair in comparison.pairs
        if pair.naive is not None and pair.naive.p < comparison.terms.level and not comparison.significant(pair)
    ]
    if claims:
        yield _T_TEST.format(others=comparison.others, claims=list_names(claims, 5))
    yield from _refusals(comparison, of_idle=True)
    yield from _group_by_text(_NOTE, ((note, m) for m in comparison.of_metrics for note in m.notes), comparison)


def _refusals(comparison: Comparison, *, of_idle: bool) -> Iterator[str]:
    """Give each reason for missing comparisons once, separately for metrics in which all sensors read the same."""
    refused = (
        (difference.warnings[0].removeprefix(f"{metric.values.key.label}: "), metric)
        for metric, difference in comparison.pairs
        if not difference.known and _is_idle(metric) is of_idle
    )
    return _group_by_text(_REFUSED, refused, comparison)


def _group_by_text(
    template: str, pairs: Iterable[tuple[str, MetricComparison]], comparison: Comparison
) -> Iterator[str]:
    metrics: dict[str, dict[str, None]] = {}
    for text, metric in pairs:
        metrics.setdefault(text, {})[metric.values.title] = None
    for text, titles in metrics.items():
        metric_names = "all metrics" if len(titles) == len(comparison.of_metrics) > 1 else list_names(list(titles), 3)
        yield template.format(metrics=capital(metric_names), text=text)


def _rules(comparison: Comparison) -> Iterator[str]:
    terms = comparison.terms
    for rule in (*_RULES, *([_RULE_OF_NUMBERS] if terms.margins or terms.detect else [])):
        yield rule.format(
            policy=terms.policy,
            quarantine=terms.quarantine,
            adjustment=terms.adjustment,
            confidence=100 * terms.confidence,
            where="of one batch" if comparison.by is By.STATION else "at one station",
            level=terms.level,
            power=100 * terms.power,
        )


def _comparable_groups(comparison: Comparison) -> list[str]:
    """Return the reference and the groups compared with it in any metric, in order."""
    compared_groups = {metric.group for metric in comparison.metrics if metric.difference is not None}
    return [
        group.name
        for group in comparison.groups
        if group.name in compared_groups or group.name == comparison.reference
    ]


def _is_idle(metric: MetricComparison) -> bool:
    """Whether all sensors of all groups read the same, so that groups cannot differ."""
    return _are_equal([values for *_, values in metric.samples])


def _constant(metric: MetricComparison) -> list[str]:
    """Return the reading of each group if sensors of a group do not differ but groups do; else nothing."""
    samples_by_group: dict[str, list[Array]] = {}
    for name, _, values in metric.samples:
        samples_by_group.setdefault(name, []).append(values)
    reading_by_group = {
        name: float(np.mean(np.concatenate(values)))
        for name, values in samples_by_group.items()
        if sum(map(len, values))
    }
    scatter = any(
        sum(map(len, samples_by_group[name])) < 2 or not _are_equal(samples_by_group[name])
        for name in reading_by_group
    )
    if (
        all(difference.known for difference in metric.differences)
        or _is_idle(metric)
        or scatter
        or len(reading_by_group) < 2
    ):
        return []
    for digits in range(3, _MAX_DIGITS + 1):  # digits that separate them
        text_by_group = {name: amount(value, metric.values.unit, digits) for name, value in reading_by_group.items()}
        if len(set(text_by_group.values())) == len(set(reading_by_group.values())):
            break
    return [f"{name} {text}" for name, text in text_by_group.items()]


def _are_equal(samples: Sequence[Array]) -> bool:
    """Whether there are values that are equal but for rounding of means."""
    values = np.concatenate([np.zeros(0), *samples])
    return bool(len(values)) and bool(np.ptp(values) <= 1e-12 * np.abs(values).max())


def _join_groups(names: Sequence[str], most: int = 3) -> str:
    """List groups in words, ``41, 42 and 43``; for many, their number."""
    if len(names) > most:
        return f"{len(names)} groups"
    return " and ".join(", ".join(part) for part in (names[:-1], names[-1:]) if part)
