"""What each group is like by itself: yields, distributions, capability, and what sensors fail for."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain import Array, NumericsError
from cbsr_qa.domain.results import FleetRun, Outcome
from cbsr_qa.stats import (
    Capability,
    IntArray,
    Quantile,
    Yield,
    capability,
    capability_of_extremes,
    passed_share,
    quantile,
    summary,
)
from cbsr_qa.studies.compare.figures import MetricFigures
from cbsr_qa.studies.compare.groups import Grouping, decides
from cbsr_qa.studies.compare.terms import Policy, Quarantine, Terms

_PASSED = (Outcome.PASS, Outcome.MARGINAL)
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True, slots=True)
class Group:
    """A group's sensors and what became of them.

    Parameters
    ----------
    sensors, runs : how many count.
    stations, batches : names, sorted.
    passed, first_pass : shares of sensors; None where no sensor was judged.
    unmeasured, unjudged : sensors whose deciding run measured a limited quantity not, or had no limits.
    failures : (metric, sensors whose deciding run failed it), most first.
    """

    name: str
    sensors: int
    runs: int
    stations: tuple[str, ...]
    batches: tuple[str, ...]
    passed: Yield | None
    first_pass: Yield | None
    unmeasured: int
    unjudged: int
    failures: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class Described:
    """One metric of one group, one figure a sensor.

    Parameters
    ----------
    deviation : None for one sensor.
    quantiles : see :data:`QUANTILES`; empty without values.
    capability : None where ``no_capability`` says why.
    """

    group: str
    count: int
    mean: float | None
    deviation: float | None
    quantiles: tuple[Quantile, ...]
    capability: Capability | None
    no_capability: str

    @property
    def median(self) -> Quantile | None:
        """Half of the sensors lie below it."""
        return next((one for one in self.quantiles if one.share == 0.5), None)


def groups_of(
    runs: Sequence[FleetRun], grouping: Grouping, figures: Sequence[MetricFigures], terms: Terms
) -> list[Group]:
    """Describe every group."""
    failing = [(one.key.label, one.failed) for one in figures if one.failed.any()]
    return [_group(name, runs, grouping, failing, terms) for name in grouping.names]


def _group(
    name: str, runs: Sequence[FleetRun], grouping: Grouping, failing: Sequence[tuple[str, np.ndarray]], terms: Terms
) -> Group:
    tests = grouping.tests[name]
    members = [index for indices in tests.values() for index in indices]
    last = [decides(runs, indices, terms.policy) for indices in tests.values()]
    outcomes = [runs[index].outcome for index in last]
    bad = np.array([index for index in last if runs[index].outcome not in _PASSED], dtype=np.intp)
    failures = Counter({label: int(failed[bad].sum()) for label, failed in failing if failed[bad].any()})
    return Group(
        name=name,
        sensors=len(tests),
        runs=len(members),
        stations=tuple(sorted({runs[index].station for index in members})),
        batches=tuple(sorted({runs[index].batch for index in members})),
        passed=_yield(outcomes, terms),
        first_pass=_yield([runs[decides(runs, indices, Policy.FIRST)].outcome for indices in tests.values()], terms),
        unmeasured=outcomes.count(Outcome.NOT_MEASURED),
        unjudged=outcomes.count(Outcome.NOT_JUDGED),
        failures=tuple(failures.most_common()),
    )


def _yield(outcomes: Sequence[Outcome | None], terms: Terms) -> Yield | None:
    passed = sum(outcome in _PASSED for outcome in outcomes)
    count = passed + outcomes.count(Outcome.FAIL)
    if terms.quarantine is Quarantine.FAILED:
        count += outcomes.count(Outcome.NOT_MEASURED)
    return passed_share(passed, count, confidence=terms.confidence) if count else None


def described(
    figures: MetricFigures, runs: Sequence[FleetRun], name: str, indices: IntArray, terms: Terms
) -> Described:
    """Describe one metric of a group.

    Parameters
    ----------
    indices : of the runs that decide and have a value, one a sensor of the group.
    """
    values = figures.mean[indices]
    if not len(values):
        return Described(name, 0, None, None, (), None, "nothing was measured")
    found = summary(values, figures.key.label)
    quantiles = tuple(quantile(values, share, confidence=terms.confidence) for share in QUANTILES)
    index, why = _capability(figures, runs, indices, terms)
    return Described(name, found.count, found.mean, found.deviation, quantiles, index, why)


def _capability(
    figures: MetricFigures, runs: Sequence[FleetRun], indices: IntArray, terms: Terms
) -> tuple[Capability | None, str]:
    """Capability of what the limit judges: of several values a run, those nearest to each limit."""
    if not figures.limited:
        return None, "no limit"
    try:
        if figures.lower is None or figures.upper is None or figures.per_run == 1:
            limits = {"lower": figures.lower, "upper": figures.upper, "confidence": terms.confidence}
            members = _subgroups(_worst(figures), runs, indices)
            return capability(members, what=figures.key.label, **limits), ""  # type: ignore[arg-type]
        return capability_of_extremes(
            *(_subgroups(values, runs, indices) for values in (figures.least, figures.most)),
            lower=figures.lower,
            upper=figures.upper,
            confidence=terms.confidence,
            what=figures.key.label,
        ), ""
    except NumericsError as error:
        return None, error.reason


def _subgroups(values: Array, runs: Sequence[FleetRun], indices: IntArray) -> list[list[float]]:
    """Values of each batch on each station."""
    found: dict[tuple[str, str], list[float]] = {}
    for index, value in zip(indices.tolist(), values[indices].tolist(), strict=True):
        found.setdefault((runs[index].batch, runs[index].station), []).append(value)
    members = list(found.values())
    if len(indices) == len(members):  # every subgroup has one value: no short term to speak of
        return [[value for group in members for value in group]]
    return members


def _worst(figures: MetricFigures) -> Array:
    if figures.per_run == 1:
        return figures.mean
    return figures.most if figures.lower is None else figures.least
