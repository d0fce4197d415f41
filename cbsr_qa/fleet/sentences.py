"""What a comparison says in plain sentences: first what differs, then what was not shown, then what stays open."""

from collections.abc import Iterator

from cbsr_qa.fleet.comparison import Comparison
from cbsr_qa.fleet.differences import Difference
from cbsr_qa.fleet.figures import named
from cbsr_qa.fleet.metric import MetricComparison
from cbsr_qa.fleet.terms import POLICY_WORDS, QUARANTINE_WORDS, Adjustment
from cbsr_qa.report.numbers import number, plural, unit_shown

_ADJUSTED = {
    Adjustment.HOLM: "adjusted for all metrics by Holm's method",
    Adjustment.BENJAMINI_HOCHBERG: "adjusted for all metrics by Benjamini and Hochberg's method",
    Adjustment.NONE: "not adjusted for the number of metrics",
}


def headline(found: Comparison) -> str:
    """Return the comparison in one line."""
    every = [group.name for group in found.groups]
    names = " and ".join(", ".join(part) for part in (every[:-1], every[-1:]) if part)
    if len(every) > 3:
        names = f"{len(every)} {_groups(found)}"
    if not found.compared:
        return f"{names}: nothing could be compared"
    tested = {m.figures.key for m in found.metrics if any(d.value is not None for d in m.differences)}
    differ = {m.figures.key for m in found.metrics if any(significant(d, found) for d in m.differences)}
    if not differ:
        return f"{names} are not shown to differ in any of {plural(len(tested), 'metric')}"
    return f"{names} differ in {len(differ)} of {plural(len(tested), 'metric')}"


def significant(difference: Difference, found: Comparison) -> bool:
    """Whether an adjusted p value is below the level."""
    return difference.p_adjusted is not None and difference.p_adjusted < found.terms.level


def sentences(found: Comparison) -> list[str]:
    """Return what there is to say, the most important first."""
    return [
        *_differences(found),
        *_equivalent(found),
        *_claims(found),
        *_not_shown(found),
        *_stations(found),
        *_refused(found),
        *_weak(found),
        *found.warnings,
    ]


def rules(found: Comparison) -> list[str]:
    """Return the rules of the comparison in sentences."""
    terms = found.terms
    return [
        f"Retests: {POLICY_WORDS[terms.policy]}. First-pass yield counts each sensor's first finished run.",
        f"Quarantine: {QUARANTINE_WORDS[terms.quarantine]}.",
        f"Intervals hold with {100 * terms.confidence:g} % each; p values are {_ADJUSTED[terms.adjustment]}.",
        "A sensor's figure of a metric with one value a load is the mean over the loads of its recipe; capability is "
        "of the load nearest to the limit, because that one decides.",
    ]


def difference_words(metric: MetricComparison, one: Difference) -> str:
    """Say on which side a difference lies, and how far: ``0.81 mm (0.62 to 1.00 mm) above``."""
    assert one.value is not None
    assert one.interval is not None
    size = one.interval.scaled(-1) if one.value < 0 else one.interval
    unit, side = metric.figures.unit, "below" if one.value < 0 else "above"
    return f"{_amount(abs(one.value), unit)} ({number(size.low)} to {_amount(size.high, unit)}) {side}"


def p_words(p_value: float | None) -> str:
    """Write a p value: ``p = 0.012``, ``p < 0.0001``."""
    if p_value is None:
        return "no p"
    return "p < 0.0001" if p_value < 1e-4 else f"p = {p_value:.2g}"


def _amount(value: float, unit: str) -> str:
    return f"{number(value, 3)} {unit_shown(unit)}".rstrip()


def _groups(found: Comparison) -> str:
    words = {"batch": "batches", "software": "software versions"}
    return words.get(found.terms.by.value, f"{found.terms.by}s")


def _each(found: Comparison) -> Iterator[tuple[MetricComparison, Difference]]:
    for metric in found.metrics:
        for one in metric.differences:
            yield metric, one


def _differences(found: Comparison) -> Iterator[str]:
    told = [(metric, one) for metric, one in _each(found) if significant(one, found)]
    for metric, one in sorted(told, key=lambda pair: (pair[1].p_adjusted or 0, -abs(pair[1].effect or 0))):
        size = f", {number(abs(one.effect), 2)} deviations of single sensors" if one.effect else ""
        yield (
            f"{metric.figures.key.label}: {one.group} lies {difference_words(metric, one)} {one.reference}"
            f"{size} ({p_words(one.p_adjusted)}), with the {_other(found)}' differences taken out."
        )


def _other(found: Comparison) -> str:
    return "batches" if found.terms.by == "station" else "stations"


def _equivalent(found: Comparison) -> Iterator[str]:
    for metric, one in _each(found):
        test = one.equivalence
        if test is None:
            continue
        margin = _amount(test.margin, metric.figures.unit)
        if test.equivalent:
            yield f"{metric.figures.key.label}: {one.group} and {one.reference} are alike within ± {margin}."
        else:
            needed = f"; about {one.needed} sensors each would tell {margin}" if one.needed else ""
            yield (
                f"{metric.figures.key.label}: {one.group} and {one.reference} are not shown to be alike within "
                f"± {margin}{needed}."
            )


def _claims(found: Comparison) -> Iterator[str]:
    """Where a test that ignores stations would have claimed what the model does not find, or cannot tell."""
    told = []
    for metric, one in _each(found):
        naive = one.naive
        if naive is not None and naive.p_value < found.terms.level and not significant(one, found):
            told.append(
                f"{metric.figures.key.label} ({one.group} − {one.reference}: "
                f"{_amount(naive.difference, metric.figures.unit)}, {p_words(naive.p_value)})"
            )
    if told:
        yield (
            f"A t test that knows neither {_other(found)} nor the number of metrics would have claimed what is not "
            f"found here: {'; '.join(told[:5])}{f' and {len(told) - 5} more' if len(told) > 5 else ''}."
        )


def _not_shown(found: Comparison) -> Iterator[str]:
    """Name metrics in which no pair is shown to differ, and of the others the pairs that are not."""
    names = []
    for metric in found.metrics:
        told = [one for one in metric.differences if one.p_adjusted is not None]
        pairs = [f"{one.group} − {one.reference}" for one in told if not significant(one, found)]
        if pairs:
            some = "" if len(pairs) == len(told) else f" of {named(pairs)}"
            names.append(f"{metric.figures.key.label}{some}")
    if names:
        yield (
            f"Not shown to differ: {named(names, 8)}. That does not make them alike: state a margin (--margin) "
            "to test for that."
        )


def _stations(found: Comparison) -> Iterator[str]:
    for metric in found.metrics:
        for one in metric.stations:
            if significant(one, found):
                yield (
                    f"{metric.figures.key.label}: station {one.group} reads {difference_words(metric, one)} "
                    f"{one.reference} ({p_words(one.p_adjusted)})."
                )


def _refused(found: Comparison) -> Iterator[str]:
    reasons: dict[str, list[str]] = {}
    for metric, one in _each(found):
        if one.value is None:
            for why in one.warnings:
                own = why.removeprefix(f"{metric.figures.key.label}: ")
                reasons.setdefault(own, []).append(metric.figures.key.label)
    for why, names in reasons.items():
        yield f"Not compared ({named(list(dict.fromkeys(names)))}): {why}."


def _weak(found: Comparison) -> Iterator[str]:
    notes: dict[str, list[str]] = {}
    for metric in found.metrics:
        for note in metric.notes:
            notes.setdefault(note, []).append(metric.figures.key.label)
    for note, names in notes.items():
        where = "all metrics" if len(names) == len(found.metrics) > 1 else named(names, 3)
        yield f"{where}: {note}."
