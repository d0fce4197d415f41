"""The page of ``cbsr-qa compare``: sentences first, then distributions, maps of differences and tables."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from cbsr_qa.domain.report import Block, Paragraph, Section, Table
from cbsr_qa.fleet.comparison import Comparison
from cbsr_qa.fleet.describe import Described
from cbsr_qa.fleet.differences import Difference
from cbsr_qa.fleet.metric import MetricComparison
from cbsr_qa.fleet.sentences import headline, p_words, rules, sentences, significant
from cbsr_qa.report.figures_groups import map_figure, strip_figure
from cbsr_qa.report.numbers import number, plural, unit_shown
from cbsr_qa.report.page import Banner, Page
from cbsr_qa.report.render import render_sections, write_report
from cbsr_qa.report.tables import text_table
from cbsr_qa.stats.capability import Index
from cbsr_qa.stats.samples import Interval
from cbsr_qa.stats.yields import Yield

#: Metrics that are drawn: those that differ first, then those with limits.
_MOST_DRAWN: Final = 12
_NAIVE: Final = (
    "The column “t test” is what Welch's test of one figure a sensor claims, which knows nothing of stations and of "
    "how many metrics there are. Where it and the model disagree, the stations made the difference, or chance did."
)


def write_page(found: Comparison, path: Path) -> None:
    """Write the page. RefusedError if it cannot be written."""
    write_report(path, render_sections(_page(found), tuple(_sections(found))))


def _page(found: Comparison) -> Page:
    reason = next(iter(sentences(found)), "nothing is to be said")
    banner = Banner("plain", "●" if found.compared else "–", headline(found), reason)
    identity = (
        ("Compared by", str(found.terms.by)),
        ("Reference", found.reference),
        ("Sensors", str(sum(group.sensors for group in found.groups))),
        ("Runs", str(sum(group.runs for group in found.groups))),
        ("Stations", ", ".join(sorted({name for group in found.groups for name in group.stations}))),
        ("Recipes", ", ".join(found.recipes)),
    )
    return Page("Comparison", f"by {found.terms.by}", banner, identity, found.simulated, found.warnings)


def _sections(found: Comparison) -> Iterator[Section]:
    said = [words for words in sentences(found) if words not in found.warnings]
    yield Section("In plain words", tuple(Paragraph(words) for words in said))
    yield Section("Groups", (_groups_table(found), *_failure_tables(found)))
    if len(found.groups) > 1:
        yield Section("Differences", (*_difference_tables(found), Paragraph(_NAIVE, "note")))
    drawn = _drawn(found)
    names = [group.name for group in found.groups]
    if drawn:
        blocks = tuple(strip_figure(m.figures.key.label, m.figures.unit, m.samples, names) for m in drawn)
        left = len(found.metrics) - len(drawn)
        rest = (Paragraph(f"{plural(left, 'metric')} more in the tables only.", "note"),) if left else ()
        yield Section("Distributions", (*blocks, *rest))
    maps = tuple(_maps(drawn, found))
    if maps:
        yield Section("Where on the sheet", maps)
    if any(metric.stations for metric in found.metrics):
        yield Section("Stations", (_stations_table(found),))
    yield Section("Figures of each group", (_described_table(found), _capability_table(found)))
    yield Section("Rules", tuple(Paragraph(words) for words in rules(found)))


def _drawn(found: Comparison) -> list[MetricComparison]:
    def rank(metric: MetricComparison) -> tuple[bool, float, bool]:
        told = [one for one in metric.differences if significant(one, found)]
        return not told, min((one.p_adjusted or 0.0 for one in told), default=1.0), not metric.figures.limited

    members = [metric for metric in found.metrics if any(len(values) for *_, values in metric.samples)]
    return sorted(members, key=rank)[:_MOST_DRAWN]


def _groups_table(found: Comparison) -> Table:
    columns = (str(found.terms.by), "sensors", "runs", "stations", "yield", "first-pass yield", "not measured")
    rows = [
        (
            group.name,
            str(group.sensors),
            str(group.runs),
            ", ".join(group.stations),
            _share(group.passed),
            _share(group.first_pass),
            str(group.unmeasured),
        )
        for group in found.groups
    ]
    return text_table("Sensors and yields, with Wilson's intervals", columns, rows, (1, 2, 6))


def _failure_tables(found: Comparison) -> Iterator[Block]:
    for group in found.groups:
        if group.failures:
            total, rows = sum(count for _, count in group.failures), []
            for label, count in group.failures[:12]:
                rows.append((label, str(count), f"{100 * count / total:.0f} %"))
            caption = f"What sensors of {group.name} fail, most first; one sensor may fail several"
            yield text_table(caption, ("metric", "sensors", "of all failures"), rows, (1, 2))


def _difference_tables(found: Comparison) -> Iterator[Block]:
    columns = [
        "metric",
        "difference",
        "interval",
        "p",
        "effect",
        "within margin",
        "shift (robust)",
        "t test",
        "model",
    ]
    for group in found.groups[1:]:
        rows = [
            _difference_row(metric, one, found)
            for metric in found.metrics
            for one in metric.differences
            if one.group == group.name
        ]
        yield text_table(f"{group.name} − {found.reference}", columns, rows, (1, 2, 3, 4))


def _difference_row(metric: MetricComparison, one: Difference, found: Comparison) -> tuple[str, ...]:
    equal = "–" if one.equivalence is None else "alike" if one.equivalence.equivalent else "not shown"
    naive = "–" if one.naive is None else f"{number(one.naive.difference)} ({p_words(one.naive.p_value)})"
    robust = "–" if one.robust is None else f"{number(one.robust.shift)} ({p_words(one.robust.p_value)})"
    return (
        _label(metric),
        "–" if one.value is None else number(one.value),
        _ends(one.interval),
        "–" if one.p_adjusted is None else p_words(one.p_adjusted).removeprefix("p = ").removeprefix("p "),
        "–" if one.effect is None else number(one.effect, 2),
        equal if one.needed is None else f"{equal}; {one.needed} sensors for {number(one.detect or 0)}",
        robust,
        naive,
        one.model.partition(":")[0],
    )


def _maps(drawn: Sequence[MetricComparison], found: Comparison) -> Iterator[Block]:
    for metric in drawn:
        for name, places in metric.maps.items():
            known = [
                (place.location, place.x_mm, place.y_mm, place.value, place.p_adjusted < found.terms.level)
                for place in places
                if place.x_mm is not None and place.y_mm is not None
            ]
            who = f"{name} − {found.reference}"
            if known:
                yield map_figure(metric.figures.key.label, metric.figures.unit, who, known)
            rows = [
                (p.location, number(p.value), f"{number(p.low)} to {number(p.high)}", p_words(p.p_adjusted))
                for p in places
            ]
            columns = ("place", "difference", "interval", "p, adjusted for the places")
            yield text_table(f"{_label(metric)}: {who} by place", columns, rows, (1, 2, 3))


def _stations_table(found: Comparison) -> Table:
    rows = [
        (
            _label(metric),
            f"{one.group} − {one.reference}",
            "–" if one.value is None else number(one.value),
            _ends(one.interval),
            p_words(one.p_adjusted),
        )
        for metric in found.metrics
        for one in metric.stations
    ]
    caption = "What stations read above the one with most runs, the groups' differences taken out"
    return text_table(caption, ("metric", "stations", "difference", "interval", "p"), rows, (2, 3, 4))


def _described_table(found: Comparison) -> Table:
    columns = ("metric", "group", "n", "mean", "spread", "5 %", "25 %", "median", "75 %", "95 %")
    rows = [
        (_label(metric), one.group, str(one.count), *_moments(one))
        for metric in found.metrics
        for one in metric.described
    ]
    return text_table("Of one figure a sensor; spread is the standard deviation", columns, rows, tuple(range(2, 10)))


def _moments(one: Described) -> tuple[str, ...]:
    moments = [one.mean, one.deviation, *(found.value for found in one.quantiles)]
    return tuple("–" if value is None else number(value) for value in (*moments, *[None] * (7 - len(moments))))


def _capability_table(found: Comparison) -> Table:
    rows: list[tuple[str, ...]] = []
    for metric in found.metrics:
        for one in metric.described if metric.figures.limited else ():
            if one.capability is None:
                rows.append((_label(metric), one.group, "–", "–", "–", "–", one.no_capability))
            else:
                made = one.capability
                rows.append((_label(metric), one.group, *map(_index, (made.cp, made.cpk, made.pp, made.ppk)), ""))
    columns = ("metric", "group", "Cp", "Cpk", "Pp", "Ppk", "why not")
    return text_table("Capability against the recipe's limits, with intervals", columns, rows, (2, 3, 4, 5))


def _label(metric: MetricComparison) -> str:
    unit = unit_shown(metric.figures.unit)
    return f"{metric.figures.key.label} [{unit}]" if unit else metric.figures.key.label


def _index(index: Index | None) -> str:
    return "–" if index is None else f"{index.value:.2f} ({index.interval.low:.2f} to {index.interval.high:.2f})"


def _ends(interval: Interval | None) -> str:
    return "–" if interval is None else f"{number(interval.low)} to {number(interval.high)}"


def _share(found: Yield | None) -> str:
    if found is None:
        return "not judged"
    return f"{100 * found.value:.1f} % ({100 * found.wilson.low:.0f} to {100 * found.wilson.high:.0f} %)"
