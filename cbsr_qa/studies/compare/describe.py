"""What each group of sensors shows by itself: yields, distributions, capability, and failures."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunLine
from cbsr_qa.stats.crossings import IntArray
from cbsr_qa.stats.fitted_capability import FittedCapability, fitted_capability
from cbsr_qa.stats.percentile_capability import percentile_index, percentile_index_of_extremes
from cbsr_qa.stats.process_capability import Capability, Index, capability, capability_of_extremes, pass_rate
from cbsr_qa.stats.samples import Interval, quantile, summary
from cbsr_qa.studies.compare.groups import PASSED, Grouping, decides
from cbsr_qa.studies.compare.terms import Policy, Quarantine, Terms
from cbsr_qa.studies.compare.values import MetricValues, OfMetric
from cbsr_qa.studies.selection import BY_OPERATOR

#: Quantiles of a distribution that are stated, as the share of sensors below each.
QUANTILES: Final = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True, slots=True)
class Failures:
    """Number of sensors that failed a metric in their deciding run."""

    metric: str
    sensors: int


@dataclass(frozen=True, slots=True)
class Group:
    """A group's sensors and their results.

    Parameters
    ----------
    n, runs : number of sensors and number of runs that count.
    passed, first_pass_yield : shares of sensors, 0 to 1, with Wilson's intervals; None if no sensor was judged.
    not_measured, not_judged : sensors whose deciding run could not measure a limited quantity, or had no limits.
    """

    name: str
    n: int
    runs: int
    passed: Annotated[float | None, Field(serialization_alias="yield")]
    yield_interval: Interval | None
    first_pass_yield: float | None
    first_pass_yield_interval: Interval | None
    not_measured: int
    not_judged: int
    stations: tuple[str, ...]
    batches: tuple[str, ...]
    failures: tuple[Failures, ...]


@dataclass(frozen=True, slots=True)
class Distribution(OfMetric):
    """One metric of one group, one value per sensor.

    Parameters
    ----------
    n : number of sensors with a value.
    mean, deviation, median : in the metric's unit; ``deviation`` is None for one sensor.
    quantiles : value at each share of :data:`QUANTILES`, which is the key; empty without values.
    no_capability : reason if ``capability`` is None.
    percentile_ppk : Ppk by percentiles, for values of any shape; None for the reason ``no_percentile_ppk``.
    fitted_capability : capability by the family that was asked for; None for the reason ``no_fitted_capability``.
    """

    group: str
    n: int
    mean: float | None = None
    deviation: float | None = None
    median: float | None = None
    median_interval: Interval | None = None
    quantiles: dict[str, float] = field(default_factory=dict)
    capability: Capability | None = None
    no_capability: str | None = None
    percentile_ppk: Index | None = None
    no_percentile_ppk: str | None = None
    fitted_capability: FittedCapability | None = None
    no_fitted_capability: str | None = None


def groups_of(
    runs: Sequence[RunLine], grouping: Grouping, values: Sequence[MetricValues], terms: Terms
) -> list[Group]:
    """Describe every group."""
    failed_by_metric = [(metric.key.label, metric.failed) for metric in values if metric.failed.any()]
    return [_describe_group(name, runs, grouping, failed_by_metric, terms) for name in grouping.names]


def _describe_group(
    name: str,
    runs: Sequence[RunLine],
    grouping: Grouping,
    failed_by_metric: Sequence[tuple[str, np.ndarray]],
    terms: Terms,
) -> Group:
    tests = grouping.tests[name]
    members = [index for indices in tests.values() for index in indices]
    deciding_runs = [decides(runs, indices, terms.policy) for indices in tests.values()]
    outcomes = [runs[index].verdict for index in deciding_runs]
    failed_runs = np.array([index for index in deciding_runs if runs[index].verdict not in PASSED], dtype=np.intp)
    failures = Counter(
        {label: int(failed[failed_runs].sum()) for label, failed in failed_by_metric if failed[failed_runs].any()}
    )
    if operator_failures := sum(
        runs[index].verdict is Outcome.FAIL and runs[index].outcome is not Outcome.FAIL for index in failed_runs
    ):
        failures[BY_OPERATOR] = operator_failures
    passed, passed_interval = _estimate_yield(outcomes, terms)
    first_pass, first_pass_interval = _estimate_yield(
        [runs[decides(runs, indices, Policy.FIRST)].verdict for indices in tests.values()], terms
    )
    return Group(
        name=name,
        n=len(tests),
        runs=len(members),
        passed=passed,
        yield_interval=passed_interval,
        first_pass_yield=first_pass,
        first_pass_yield_interval=first_pass_interval,
        not_measured=outcomes.count(Outcome.NOT_MEASURED),
        not_judged=outcomes.count(Outcome.NOT_JUDGED),
        stations=tuple(sorted({runs[index].station for index in members})),
        batches=tuple(sorted({runs[index].batch for index in members})),
        failures=tuple(Failures(label, count) for label, count in failures.most_common()),
    )


def _estimate_yield(outcomes: Sequence[Outcome | None], terms: Terms) -> tuple[float | None, Interval | None]:
    """Return the share of judged sensors that passed, with Wilson's interval; None for both if none was judged."""
    passed = sum(outcome in PASSED for outcome in outcomes)
    count = passed + outcomes.count(Outcome.FAIL)
    if terms.quarantine is Quarantine.FAILED:
        count += outcomes.count(Outcome.NOT_MEASURED)
    if not count:
        return None, None
    share = pass_rate(passed, count, confidence=terms.confidence)
    return share.value, share.wilson


def distribution(
    metric: MetricValues, runs: Sequence[RunLine], name: str, indices: IntArray, terms: Terms
) -> Distribution:
    """Describe one metric of a group by the deciding runs with a value, one per sensor."""
    values = metric.mean[indices]
    if not len(values):
        return Distribution(*metric.identity, name, 0, no_capability="nothing was measured")
    moments = summary(values, metric.key.label)
    quantiles = {probability: quantile(values, probability, confidence=terms.confidence) for probability in QUANTILES}
    group_capability, why = _estimate_capability(metric, runs, indices, terms)
    fitted, why_not_fitted = _fit_capability(metric, runs, indices, terms)
    percentile_ppk = None if group_capability is None else _estimate_percentile_index(metric, runs, indices, terms)
    return Distribution(
        *metric.identity,
        group=name,
        n=moments.count,
        mean=moments.mean,
        deviation=moments.deviation,
        median=quantiles[0.5].value,
        median_interval=quantiles[0.5].interval,
        quantiles={f"{probability:g}": estimate.value for probability, estimate in quantiles.items()},
        capability=group_capability,
        no_capability=why,
        percentile_ppk=percentile_ppk if isinstance(percentile_ppk, Index) else None,
        no_percentile_ppk=percentile_ppk if isinstance(percentile_ppk, str) else None,
        fitted_capability=fitted,
        no_fitted_capability=why_not_fitted,
    )


def _estimate_capability(
    metric: MetricValues, runs: Sequence[RunLine], indices: IntArray, terms: Terms
) -> tuple[Capability | None, str | None]:
    """Return the capability of the judged values, or the reason for none; of several per run the worst ones count."""
    if not metric.limited:
        return None, "no limit"
    try:
        if metric.lower is None or metric.upper is None or metric.per_run == 1:
            members = _split_by_batch_and_station(_pick_deciding(metric), runs, indices)
            limits = {"lower": metric.lower, "upper": metric.upper, "confidence": terms.confidence}
            return capability(members, what=metric.key.label, **limits), None  # type: ignore[arg-type]
        return capability_of_extremes(
            *(_split_by_batch_and_station(values, runs, indices) for values in (metric.least, metric.most)),
            lower=metric.lower,
            upper=metric.upper,
            confidence=terms.confidence,
            what=metric.key.label,
        ), None
    except NumericsError as error:
        return None, error.reason


def _estimate_percentile_index(
    metric: MetricValues, runs: Sequence[RunLine], indices: IntArray, terms: Terms
) -> Index | str:
    """Return Ppk by percentiles of the values that capability uses, or the reason for none."""
    if metric.lower is None or metric.upper is None or metric.per_run == 1:
        members = _split_by_batch_and_station(_pick_deciding(metric), runs, indices)
        return percentile_index(members, lower=metric.lower, upper=metric.upper, confidence=terms.confidence)
    return percentile_index_of_extremes(
        *(_split_by_batch_and_station(values, runs, indices) for values in (metric.least, metric.most)),
        lower=metric.lower,
        upper=metric.upper,
        confidence=terms.confidence,
    )


def _fit_capability(
    metric: MetricValues, runs: Sequence[RunLine], indices: IntArray, terms: Terms
) -> tuple[FittedCapability | None, str | None]:
    """Return the capability by the family that was asked for, or the reason for none; two Nones if none was."""
    family = terms.distribution_of(metric.key.name)
    if family is None or not metric.limited:
        return None, None if family is None else "no limit"
    if metric.lower is not None and metric.upper is not None and metric.per_run > 1:
        return None, "both limits judge several values of a run, which are not of one distribution"
    members = _split_by_batch_and_station(_pick_deciding(metric), runs, indices)
    limits = {"lower": metric.lower, "upper": metric.upper}
    try:
        return fitted_capability(members, family, confidence=terms.confidence, **limits), None
    except NumericsError as error:
        return None, error.reason


def _pick_deciding(metric: MetricValues) -> Array:
    """Return the values that one limit judges: of several per run the worst."""
    if metric.per_run == 1:
        return metric.mean
    return metric.most if metric.lower is None else metric.least


def _split_by_batch_and_station(values: Array, runs: Sequence[RunLine], indices: IntArray) -> list[list[float]]:
    """Return the values of some runs by batch and station; all in one subgroup if none of these has two."""
    subgroups: dict[tuple[str, str], list[float]] = {}
    for index, value in zip(indices.tolist(), values[indices].tolist(), strict=True):
        subgroups.setdefault((runs[index].batch, runs[index].station), []).append(value)
    members = list(subgroups.values())
    if len(indices) == len(members):  # single values per subgroup have no short-term deviation
        return [[value for group in members for value in group]]
    return members
