"""What could not be compared, and why: one of the first things to be said, lest it be taken for no difference."""

from collections.abc import Iterator, Sequence

import numpy as np

from cbsr_qa.report import number, plural, unit_shown
from cbsr_qa.studies.compare.comparison import Comparison
from cbsr_qa.studies.compare.differences import Difference
from cbsr_qa.studies.compare.figures import named
from cbsr_qa.studies.compare.metric import MetricComparison

#: Digits with which values that are not the same look different, at most.
_MOST_DIGITS = 9


def each(found: Comparison) -> Iterator[tuple[MetricComparison, Difference]]:
    """Go through all differences with their metrics."""
    for metric in found.metrics:
        for one in metric.differences:
            yield metric, one


def amount(value: float, unit: str, digits: int = 3) -> str:
    """Write a value with its unit, as it stands in a sentence."""
    return f"{number(value, digits)} {unit_shown(unit)}".rstrip()


def idle(metric: MetricComparison) -> bool:
    """Whether all sensors of all groups read the same: there is nothing to tell groups apart by."""
    values = [value for *_, values in metric.samples for value in values.tolist()]
    return bool(values) and _same(values)


def compared_groups(found: Comparison) -> list[str]:
    """Return the reference and the groups that could be compared with it in any metric, in their order."""
    told = {one.group for _, one in each(found) if one.value is not None}
    return [group.name for group in found.groups if group.name in told or group.name == found.reference]


def uncompared(found: Comparison) -> str:
    """Say which groups could not be compared, wholly or in some metrics; empty where all could.

    Metrics in which all sensors read the same are not counted: nothing differs in them.
    """
    metrics = [metric for metric in found.metrics if metric.differences and not idle(metric)]
    open_ = {group.name: 0 for group in found.groups[1:]}
    for metric in metrics:
        for one in metric.differences:
            open_[one.group] += one.value is None
    known = compared_groups(found)
    groups_with: dict[int, list[str]] = {}
    for name, count in open_.items():
        groups_with.setdefault(count if name in known else len(metrics), []).append(name)
    groups_with.pop(0, None)
    said = []
    for count, names in sorted(groups_with.items(), reverse=True):
        some = f"could not be compared in {count} of {plural(len(metrics), 'metric')}"
        said.append(f"{listed(names)} {'cannot be compared' if names[0] not in known else some}")
    return "; ".join(said)


def listed(names: Sequence[str], most: int = 3) -> str:
    """List groups in words: ``41, 42 and 43``; of many how many they are."""
    if len(names) > most:
        return f"{len(names)} groups"
    return " and ".join(", ".join(part) for part in (names[:-1], names[-1:]) if part)


def refusals(found: Comparison, *, of_idle: bool) -> Iterator[str]:
    """Say why pairs were not compared, each reason once.

    Parameters
    ----------
    of_idle : of metrics in which all sensors read the same, which matter least; else of all others.
    """
    if not found.metrics and not of_idle:
        yield "Nothing was measured: no run that counts holds a measurement."
    reasons: dict[str, list[str]] = {}
    for metric, one in each(found):
        if one.value is None and idle(metric) is of_idle:
            for why in one.warnings:
                own = why.removeprefix(f"{metric.figures.key.label}: ")
                reasons.setdefault(own, []).append(metric.figures.key.label)
    for why, names in reasons.items():
        yield f"Not compared ({named(list(dict.fromkeys(names)))}): {why}."


def constants(found: Comparison) -> Iterator[str]:
    """Say what each group reads in metrics where sensors of a group do not differ, and groups do."""
    for metric in found.metrics:
        refused = [one for one in metric.differences if one.value is None]
        of_group: dict[str, list[float]] = {}
        for name, _, values in metric.samples:
            of_group.setdefault(name, []).extend(values.tolist())
        measured = {name: values for name, values in of_group.items() if values}
        if not refused or idle(metric) or not all(len(v) > 1 and _same(v) for v in measured.values()):
            continue
        if len(measured) > 1:
            read = _apart({name: float(np.mean(values)) for name, values in measured.items()}, metric.figures.unit)
            yield (
                f"{metric.figures.key.label}: all sensors of each group read the same: {named(read, 8)}. There is no "
                "scatter a test could hold these differences against."
            )


def untested(found: Comparison) -> Iterator[str]:
    """Say of which pairs likeness within a margin was asked for and could not be tested."""
    for metric in found.metrics if len(found.groups) > 1 else ():
        margin = found.terms.margins.get(metric.figures.key.name)
        pairs = [f"{one.group} − {one.reference}" for one in metric.differences if one.value is None]
        if margin is None or (metric.differences and not pairs):
            continue
        who = f"{named(pairs)} {'is' if len(pairs) == 1 else 'are'}" if pairs else "groups are"
        yield (
            f"{metric.figures.key.label}: {who} not compared, so whether they are alike within "
            f"± {amount(margin, metric.figures.unit)} was not tested."
        )


def _same(values: Sequence[float]) -> bool:
    """Whether values are the same but for the rounding of means."""
    low, high = min(values), max(values)
    return high - low <= 1e-12 * max(abs(low), abs(high))


def _apart(values: dict[str, float], unit: str) -> list[str]:
    """Write values with as many digits as tell them apart."""
    for digits in range(3, _MOST_DIGITS + 1):
        written = {name: amount(value, unit, digits) for name, value in values.items()}
        if len(set(written.values())) == len(set(values.values())):
            break
    return [f"{name} {text}" for name, text in written.items()]
