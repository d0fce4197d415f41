"""What a comparison says in plain sentences: first what differs, then what was not shown, then what stays open."""

from collections.abc import Iterator, Sequence

from cbsr_qa.domain import of_kind
from cbsr_qa.report import number
from cbsr_qa.studies.compare.comparison import Comparison
from cbsr_qa.studies.compare.differences import Difference
from cbsr_qa.studies.compare.figures import named
from cbsr_qa.studies.compare.metric import MetricComparison
from cbsr_qa.studies.compare.terms import POLICY_WORDS, QUARANTINE_WORDS, Adjustment, By
from cbsr_qa.studies.compare.uncompared import (
    amount,
    compared_groups,
    constants,
    each,
    listed,
    refusals,
    uncompared,
    untested,
)

_ADJUSTED = {
    Adjustment.HOLM: "adjusted by Holm's method for all metrics and groups",
    Adjustment.BENJAMINI_HOCHBERG: "adjusted by Benjamini and Hochberg's method for all metrics and groups",
    Adjustment.NONE: "not adjusted for the number of metrics and groups",
}


def headline(found: Comparison) -> str:
    """Return the comparison in one line; what could not be compared is not among what is not shown to differ."""
    if not found.compared:
        return f"{_names([group.name for group in found.groups], found)}: nothing could be compared"
    names = _names(compared_groups(found), found)
    tested = {m.figures.key: m for m in found.metrics if any(d.value is not None for d in m.differences)}
    differ = {m.figures.key for m in found.metrics if any(significant(d, found) for d in m.differences)}
    only = next(iter(tested)).label if len(tested) == 1 else ""
    if differ:
        said = f"{names} differ in {only or f'{len(differ)} of {len(tested)} metrics'}"
    else:
        said = f"{names} are not shown to differ in {only or f'any of {len(tested)} metrics'}"
    rest = uncompared(found)
    return f"{said}; {rest}" if rest else said


def _names(names: Sequence[str], found: Comparison) -> str:
    if len(names) > 3:
        every = len(found.groups)
        return f"{len(names)} {'' if len(names) == every else f'of {every} '}{_groups(found)}"
    return listed(names)


def significant(difference: Difference, found: Comparison) -> bool:
    """Whether an adjusted p value is below the level."""
    return difference.p_adjusted is not None and difference.p_adjusted < found.terms.level


def alike(difference: Difference, found: Comparison) -> bool:
    """Whether a difference is shown to lie within its margin, by the adjusted p value of two one-sided tests."""
    return difference.equivalence_p is not None and difference.equivalence_p <= found.terms.level


def sentences(found: Comparison) -> list[str]:
    """Return what there is to say, the most important first."""
    return [
        *_differences(found),
        *refusals(found, of_idle=False),
        *constants(found),
        *_equivalent(found),
        *untested(found),
        *_detectable(found),
        *_claims(found),
        *_not_shown(found),
        *_stations(found),
        *refusals(found, of_idle=True),
        *_weak(found),
        *found.warnings,
    ]


def rules(found: Comparison) -> list[str]:
    """Return the rules of the comparison in sentences."""
    terms = found.terms
    return [
        f"Retests: {POLICY_WORDS[terms.policy]}. First-pass yield counts each sensor's first finished run.",
        f"Quarantine: {QUARANTINE_WORDS[terms.quarantine]}.",
        "Yields, means, quantiles and capability are of what was measured, wherever the run that decides was made: "
        "what stations differ by is in them. Verdicts are those of the analysis: what somebody decided against one "
        "(cbsr-qa verdict override) does not count.",
        f"Intervals hold with {100 * terms.confidence:g} % each. p values of the model's differences are "
        f"{_ADJUSTED[terms.adjustment]}, those of stations likewise among themselves, those of places by Holm's "
        "method within their metric. Those of t tests and of robust tests are not adjusted.",
        *_rules_asked(found),
        "A sensor's figure of a metric with one value a load is the mean over the loads of its recipe; capability is "
        "of the load nearest to the limit, because that one decides.",
    ]


def _rules_asked(found: Comparison) -> Iterator[str]:
    """State what margins and differences to be found go by, where there are any."""
    terms = found.terms
    if terms.margins:
        yield (
            f"Alike within a margin: two one-sided tests. By itself a pair is alike where its {_decides(found)} "
            f"interval lies within; their p values are, among themselves, {_ADJUSTED[terms.adjustment]}, and those "
            "decide."
        )
    if terms.margins or terms.detect:
        yield (
            f"Numbers of sensors are those of each group, {_one_place(found)} and run once, with which one test at "
            f"the level {terms.level:g} succeeds with {_chance(found)}; where many tests are adjusted it takes more."
        )


def difference_words(metric: MetricComparison, one: Difference) -> str:
    """Say on which side a difference lies, and how far: ``0.81 mm (0.62 to 1.00 mm) above``."""
    assert one.value is not None
    assert one.interval is not None
    size = one.interval.scaled(-1) if one.value < 0 else one.interval
    unit, side = metric.figures.unit, "below" if one.value < 0 else "above"
    return f"{amount(abs(one.value), unit)} ({number(size.low)} to {amount(size.high, unit)}) {side}"


def p_words(p_value: float | None) -> str:
    """Write a p value with two digits: ``p = 0.012``, ``p = 0.50``, ``p < 0.0001``."""
    if p_value is None:
        return "no p"
    return "p < 0.0001" if p_value < 1e-4 else f"p = {p_value:#.2g}"


def _groups(found: Comparison) -> str:
    words = {"batch": "batches", "software": "software versions"}
    return words.get(found.terms.by.value, f"{found.terms.by}s")


def _differences(found: Comparison) -> Iterator[str]:
    told = [(metric, one) for metric, one in each(found) if significant(one, found)]
    for metric, one in sorted(told, key=lambda pair: (pair[1].p_adjusted or 0, -abs(pair[1].effect or 0))):
        size = f", {number(abs(one.effect), 2)} deviations of single sensors" if one.effect else ""
        yield (
            f"{metric.figures.key.label}: {one.group} lies {difference_words(metric, one)} {one.reference}"
            f"{size} ({p_words(one.p_adjusted)}), {_taken_out(one, found)}."
        )


def others(found: Comparison) -> tuple[str, ...]:
    """Return what must not be taken for a group: batches too, where periods or software versions are compared."""
    if found.terms.by is By.STATION:
        return ("batches",)
    batches = {name for group in found.groups for name in group.batches}
    return ("stations", "batches")[: 1 + (found.terms.by in (By.PERIOD, By.SOFTWARE) and len(batches) > 1)]


def besides(found: Comparison) -> str:
    """Return whose differences are taken out where stations are compared beside the groups."""
    batches = {name for group in found.groups for name in group.batches}
    mixed = found.terms.by in (By.MATERIAL, By.PERIOD, By.SOFTWARE) and len(batches) > 1
    return "batches'" if mixed else "groups'"


def _taken_out(one: Difference, found: Comparison) -> str:
    if len(one.taken_out) == 1:
        return f"all of batch {one.taken_out[0]}" if found.terms.by == "station" else f"all at {one.taken_out[0]}"
    owners = " and ".join(f"{noun}'" for noun in others(found))
    return f"with the {owners} differences taken out"


def _one_place(found: Comparison) -> str:
    return "all of one batch" if found.terms.by == "station" else "all at one station"


def _chance(found: Comparison) -> str:
    return f"{100 * found.terms.power:g} %"


def _equivalent(found: Comparison) -> Iterator[str]:
    """Say of each pair with a margin whether it is shown to be alike, by which interval, or what it would take."""
    tests = sum(one.equivalence is not None for _, one in each(found))
    for metric, one in each(found):
        test, unit = one.equivalence, metric.figures.unit
        if test is None:
            continue
        shown = alike(one, found)
        inside = "lies within" if test.equivalent else "does not lie within"
        if test.equivalent and not shown:
            inside = f"lies within, but not once {_all(tests)} such tests count"
        ends = f"{number(test.interval.low)} to {amount(test.interval.high, unit)}"
        yield (
            f"{metric.figures.key.label}: {one.group} and {one.reference} are {'' if shown else 'not shown to be '}"
            f"alike within ± {amount(test.margin, unit)}: the {_decides(found)} interval, {ends}, {inside} "
            f"({p_words(one.equivalence_p)}){'' if shown else f'. {_to_show(one, found)}'}."
        )


def _all(tests: int) -> str:
    return "both" if tests == 2 else f"all {tests}"


def _decides(found: Comparison) -> str:
    """Return which interval two one-sided tests at the level come to: ``90 %``."""
    return f"{100 - 200 * found.terms.level:g} %"


def _to_show(one: Difference, found: Comparison) -> str:
    assert one.equivalence is not None
    assert one.value is not None
    if abs(one.value) >= one.equivalence.margin:
        return "If the difference is what it is estimated to be, no number of sensors would show it"
    if one.needed_alike is None:
        return "More than 10⁹ sensors of each would be needed"
    return (
        f"If they do not differ, about {one.needed_alike} sensors of each, {_one_place(found)}, would show it with "
        f"{_chance(found)}"
    )


def _detectable(found: Comparison) -> Iterator[str]:
    """Say how many sensors would find the differences that were asked about; they are those of any pair of groups."""
    for metric in found.metrics:
        size = found.terms.detect.get(metric.figures.key.name)
        if size is None:
            continue
        wanted = amount(size, metric.figures.unit)
        fitted = next((one for one in metric.differences if one.deviation is not None), None)
        if fitted is None:
            yield f"{metric.figures.key.label}: not compared, so how many sensors would find {wanted} is not known."
            continue
        needed = "more than 10⁹" if fitted.needed is None else f"about {fitted.needed}"
        yield (
            f"{metric.figures.key.label}: {needed} sensors of each, {_one_place(found)}, would find a difference of "
            f"{wanted} with {_chance(found)}."
        )


def _claims(found: Comparison) -> Iterator[str]:
    """Where a test that ignores stations would have claimed what the model does not find, or cannot tell."""
    told = []
    for metric, one in each(found):
        naive = one.naive
        if naive is not None and naive.p_value < found.terms.level and not significant(one, found):
            told.append(
                f"{metric.figures.key.label} ({one.group} − {one.reference}: "
                f"{amount(naive.difference, metric.figures.unit)}, {p_words(naive.p_value)})"
            )
    if told:
        yield (
            f"A t test that knows neither {', '.join(others(found))} nor the number of metrics would have claimed "
            f"what is not found here: {'; '.join(told[:5])}{f' and {len(told) - 5} more' if len(told) > 5 else ''}."
        )


def _not_shown(found: Comparison) -> Iterator[str]:
    """Name metrics in which no pair is shown to differ, and of the others the pairs that are not."""
    open_: list[tuple[str, str]] = []
    margins: list[tuple[str, str]] = []
    for metric in found.metrics:
        told = [one for one in metric.differences if one.p_adjusted is not None and not significant(one, found)]
        if told:
            pairs = named([f"{one.group} − {one.reference}" for one in told])
            stated = metric.figures.key.name in found.terms.margins
            every = len(told) == len(metric.differences)
            (margins if stated else open_).append((metric.figures.key.label, "" if every else pairs))
    if open_:
        yield (
            f"Not shown to differ: {_with_pairs(open_)}. That does not make them alike: state a margin (--margin) "
            "to test for that."
        )
    if margins:
        said = _with_pairs(margins)
        yield f"Not shown to differ: {said}. Whether they are alike within their margin is said above."


def _with_pairs(members: Sequence[tuple[str, str]]) -> str:
    """List metrics with the pairs meant, where not all are; pairs that are the same for all only once."""
    pairs = {said for _, said in members}
    if len(members) > 1 and len(pairs) == 1 and "" not in pairs:
        return f"{named([label for label, _ in members], 8)}, all of {pairs.pop()}"
    return named([f"{label} of {said}" if said else label for label, said in members], 8)


def _stations(found: Comparison) -> Iterator[str]:
    for metric in found.metrics:
        for one in metric.stations:
            if significant(one, found):
                read = f"{of_kind('station', one.group)} reads {difference_words(metric, one)} {one.reference}"
                yield f"{metric.figures.key.label}: {read} ({p_words(one.p_adjusted)})."


def _weak(found: Comparison) -> Iterator[str]:
    notes: dict[str, list[str]] = {}
    for metric in found.metrics:
        for note in metric.notes:
            notes.setdefault(note, []).append(metric.figures.key.label)
    for note, names in notes.items():
        where = "all metrics" if len(names) == len(found.metrics) > 1 else named(names, 3)
        yield f"{where}: {note}."
