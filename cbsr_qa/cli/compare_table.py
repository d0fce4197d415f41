"""The words of ``cbsr-qa compare``: sentences, then groups, then a table of differences, a hundred columns wide."""

import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

from cbsr_qa.config.echo import printable

if TYPE_CHECKING:
    from cbsr_qa.fleet.comparison import Comparison
    from cbsr_qa.fleet.describe import Group
    from cbsr_qa.fleet.differences import Difference
    from cbsr_qa.stats.yields import Yield

WIDTH = 100
_DIFFERENCE = "  {:<38}{:>12}  {:<31}{:>8}  {}"
_GROUP = "  {:<28}{:>8}{:>6}  {:<26}{}"


def lines(found: "Comparison") -> Iterator[str]:
    """Lay out a comparison, one line after another."""
    from cbsr_qa.fleet.sentences import headline, rules, sentences

    yield printable(headline(found))
    for words in sentences(found):
        yield from _wrapped("- ", printable(words))
    yield ""
    yield from _groups(found)
    yield ""
    if any(metric.differences for metric in found.metrics):
        yield from _differences(found)
        yield ""
    for words in rules(found):
        yield from _wrapped("", words)


def _groups(found: "Comparison") -> Iterator[str]:
    yield _GROUP.format(found.terms.by.value, "sensors", "runs", "yield", "first-pass yield").rstrip()
    for group in found.groups:
        row = printable(group.name)[:27], group.sensors, group.runs, _share(group.passed), _share(group.first_pass)
        yield _GROUP.format(*row).rstrip()
        yield from _fate(group)


def _fate(group: "Group") -> Iterator[str]:
    if group.failures:
        said = ", ".join(f"{label} {count}" for label, count in group.failures[:4])
        rest = f" and {len(group.failures) - 4} more" if len(group.failures) > 4 else ""
        yield from _wrapped("      fails: ", printable(f"{said}{rest}"))
    if group.unmeasured:
        yield f"      not measured: {group.unmeasured}"


def _differences(found: "Comparison") -> Iterator[str]:
    for group in found.groups[1:]:
        yield printable(f"{group.name} − {found.reference}")
        yield _DIFFERENCE.format("metric", "difference", f"{100 * found.terms.confidence:g} % interval", "p", "model")
        for metric in found.metrics:
            label = printable(metric.figures.key.label)
            for one in metric.differences:
                if one.group == group.name:
                    yield from _difference(label, metric.figures.unit, one)


def _difference(label: str, unit: str, one: "Difference") -> Iterator[str]:
    from cbsr_qa.fleet.sentences import p_words
    from cbsr_qa.report.numbers import number, unit_shown

    if len(label) > 37:
        yield f"  {label}"
        label = ""
    if one.value is None or one.interval is None:
        yield _DIFFERENCE.format(label, "–", "refused", "", "").rstrip()
        return
    ends = f"{number(one.interval.low)} to {number(one.interval.high)} {unit_shown(unit)}"
    p_value = p_words(one.p_adjusted).removeprefix("p = ").removeprefix("p ")
    yield _DIFFERENCE.format(label, number(one.value), ends, p_value, one.model.partition(":")[0]).rstrip()


def _share(found: "Yield | None") -> str:
    if found is None:
        return "not judged"
    ends = f"{100 * found.wilson.low:.0f} to {100 * found.wilson.high:.0f}"
    return f"{100 * found.value:.1f} % ({ends} %)"


def _wrapped(label: str, words: str) -> list[str]:
    return textwrap.wrap(
        words, WIDTH, initial_indent=label, subsequent_indent=" " * len(label), break_on_hyphens=False
    )
