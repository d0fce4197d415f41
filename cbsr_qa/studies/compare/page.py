"""The page of ``cbsr-qa compare``: sentences first, then distributions, maps of differences and tables."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from cbsr_qa.domain.results import Banner, Block, Page, Paragraph, Section, Table
from cbsr_qa.report import number, plural, render_sections, text_table, unit_shown, write_report
from cbsr_qa.stats import Index, Interval, Yield
from cbsr_qa.studies.compare.comparison import Comparison
from cbsr_qa.studies.compare.describe import Described
from cbsr_qa.studies.compare.differences import Difference
from cbsr_qa.studies.compare.draw import map_figure, strip_figure
from cbsr_qa.studies.compare.metric import MetricComparison
from cbsr_qa.studies.compare.wording import alike, besides, headline, p_words, rules, sentences, significant

#: Metrics that are drawn: those that differ first, then those with limits.
_MOST_DRAWN: Final = 12
_OTHERS: Final = (
    "The t test is Welch's of one figure a sensor, and knows nothing of stations and of how many metrics there are. "
    "Where it and the model disagree, the stations made the difference, or chance did. The shift is Hodges and "
    "Lehmann's, with the model's differences of stations taken out."
)

_DIFFERENCE: Final = ("metric", "difference", "interval", "p", "effect", "model")
_OTHER_COLUMNS: Final = ("metric", "method", "difference", "interval", "p")


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
    if len(found.groups) > 1 and found.metrics:
        yield Section("Differences", tuple(_difference_blocks(found)))
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
    if found.metrics:
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
    return text_table(
        "Sensors and yields of what was measured, stations' differences included, with Wilson's intervals",
        columns,
        rows,
        (1, 2, 6),
    )


def _failure_tables(found: Comparison) -> Iterator[Block]:
    for group in found.groups:
        if group.failures:
            total, rows = sum(count for _, count in group.failures), []
            for label, count in group.failures[:12]:
                rows.append((label, str(count), f"{100 * count / total:.0f} %"))
            caption = f"What sensors of {group.name} fail, most first; one sensor may fail several"
            yield text_table(caption, ("metric", "sensors", "of all failures"), rows, (1, 2))


def _difference_blocks(found: Comparison) -> Iterator[Block]:
    for group in found.groups[1:]:
        pairs = [(m, one) for m in found.metrics for one in m.differences if one.group == group.name]
        who = f"{group.name} − {found.reference}"
        yield text_table(who, _DIFFERENCE, [_difference_row(*pair) for pair in pairs], (1, 2, 3, 4))
        rows = [_likeness_row(metric, one, found) for metric, one in pairs if one.equivalence is not None]
        if rows:
            yield text_table(f"{who}: alike within a margin?", _likeness_columns(found), rows, (1, 2, 3, 4, 6))
        rows = [row for pair in pairs for row in _other_rows(*pair)]
        if rows:
            yield text_table(f"{who} by other methods; p not adjusted", _OTHER_COLUMNS, rows, (2, 3, 4))
    yield Paragraph(_OTHERS, "note")
    rows = list(_needed_rows(found))
    if rows:
        caption = f"Sensors of each group that would find a difference with {100 * found.terms.power:g} %"
        yield text_table(caption, ("metric", "difference", "sensors of each"), rows, (1, 2))


def _difference_row(metric: MetricComparison, one: Difference) -> tuple[str, ...]:
    return (
        _label(metric),
        "–" if one.value is None else number(one.value),
        _ends(one.interval),
        _p(one.p_adjusted),
        "–" if one.effect is None else number(one.effect, 2),
        one.model.partition(":")[0],
    )


def _likeness_columns(found: Comparison) -> tuple[str, ...]:
    terms = found.terms
    deciding = f"{100 - 200 * terms.level:g} % interval"
    return (
        "metric",
        "margin",
        "difference",
        deciding,
        "p",
        "alike",
        f"sensors to show it with {100 * terms.power:g} %",
    )


def _likeness_row(metric: MetricComparison, one: Difference, found: Comparison) -> tuple[str, ...]:
    test, value = one.equivalence, one.value
    assert test is not None
    assert value is not None
    hopeless = abs(value) >= test.margin
    return (
        _label(metric),
        f"± {number(test.margin)}",
        number(value),
        _ends(test.interval),
        _p(one.equivalence_p),
        "yes" if alike(one, found) else "not shown",
        "none would" if hopeless else "> 10⁹" if one.needed_alike is None else str(one.needed_alike),
    )


def _other_rows(metric: MetricComparison, one: Difference) -> Iterator[tuple[str, ...]]:
    """A row for each of the other methods that had an answer: numbers of both side by side would not fit a page."""
    if one.robust is not None:
        shift, robust = f"shift; {one.robust.method}", one.robust
        yield _label(metric), shift, number(robust.shift), _ends(robust.interval), _p(robust.p_value)
    if one.naive is not None:
        yield _label(metric), "t test", number(one.naive.difference), _ends(one.naive.interval), _p(one.naive.p_value)


def _needed_rows(found: Comparison) -> Iterator[tuple[str, ...]]:
    for metric in found.metrics:
        asked = next((one for one in metric.differences if one.detect is not None), None)
        if asked is not None and asked.detect is not None:
            count = "> 10⁹" if asked.needed is None else str(asked.needed)
            yield _label(metric), number(asked.detect), count


def _p(p_value: float | None) -> str:
    return "–" if p_value is None else p_words(p_value).removeprefix("p = ").removeprefix("p ")


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
                (p.location, number(p.value), f"{number(p.low)} to {number(p.high)}", _p(p.p_adjusted))
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
            _p(one.p_adjusted),
        )
        for metric in found.metrics
        for one in metric.stations
    ]
    caption = (
        f"What stations read above the one with most runs, the {besides(found)} differences taken out; "
        "only stations that runs connect can be compared"
    )
    return text_table(caption, ("metric", "stations", "difference", "interval", "p"), rows, (2, 3, 4))


def _described_table(found: Comparison) -> Table:
    columns = ("metric", "group", "n", "mean", "spread", "5 %", "25 %", "median", "75 %", "95 %")
    rows = [
        (_label(metric), one.group, str(one.count), *_moments(one))
        for metric in found.metrics
        for one in metric.described
    ]
    return text_table(
        "Of one figure a sensor as it was measured, stations' differences included; spread is the standard deviation",
        columns,
        rows,
        tuple(range(2, 10)),
    )


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
    columns: tuple[str, ...] = ("metric", "group", "Cp", "Cpk", "Pp", "Ppk", "why not")
    if not any(row[-1] for row in rows):  # an empty column takes the room of the names
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    return text_table(
        "Capability against the recipe's limits, stations' differences included, with intervals",
        columns,
        rows,
        (2, 3, 4, 5),
    )


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
