"""Checks that a stored verdict follows from its stored measurements, by the recipe that judged them."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import Final

from cbsr_qa.analysis.evaluate import judge
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.config.merging import restore
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.plan.plan import Recipe
from cbsr_qa.domain.results.listed import ListedRun
from cbsr_qa.domain.results.measurement import Measurement, Verdict, decide
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.results.analyses import StoredAnalysis

_REMEDY: Final = "restore the database from a copy; nothing is shown of a verdict that does not follow"


def judging_recipe(store: Repository, run: str, stored: StoredAnalysis | None) -> Recipe:
    """Return the recipe that an analysis follows from: the run's own, or the one of an adopted re-analysis."""
    if stored is None or stored.adoption is None:
        return restore(store.runs.read_configuration(run)).recipe
    return load_recipe(json.loads(stored.adoption.recipe)).value


def check_decided(record: RunRecord, stored: StoredAnalysis, limits: Iterable[Limit]) -> None:
    """Decide an analysis again.

    Limits are compared with the configuration only if the run is chained, and the reason's wording only if this
    version wrote it: earlier versions may differ.

    Raises
    ------
    StoreError
        If a stored limit, an outcome or the verdict does not follow; it names the measurement.
    """
    verdict, measurements = stored.verdict, stored.measurements
    if record.end is not EndReason.FINISHED or not measurements:
        if verdict.outcome not in (Outcome.NOT_MEASURED, Outcome.NOT_JUDGED):
            mismatch = "holds no measurement" if record.end is EndReason.FINISHED else f"was {record.end}"
            raise _mismatch_error(stored, f"the verdict states {verdict.outcome}; the run {mismatch}")
        return
    _check_measurements(stored, limits if record.chain.chained else None)
    decided = decide(measurements)
    same_words = dict(stored.software).get("cbsr-qa") == version("cbsr-qa")
    if decided.outcome is not verdict.outcome or (same_words and decided.reason != verdict.reason):
        raise _mismatch_error(
            stored, f"the verdict states {_verdict(verdict)}; its measurements say {_verdict(decided)}"
        )


def check_listed(run: ListedRun, judged: Sequence[Measurement]) -> None:
    """Decide the outcome of a listed run again from its measurements with a limit, judged by these limits.

    Raises
    ------
    StoreError
        If an outcome does not follow; it names the measurement.
    """
    for stored, rejudged in zip(judged, _rejudge(judged), strict=True):
        if stored.outcome is not rejudged.outcome:
            raise StoreError(
                f"run {run.run}: {_describe_measurement(stored)} {_difference(stored, rejudged)}", remedy=_REMEDY
            )
    if not run.finished or run.outcome in (None, Outcome.NOT_MEASURED, Outcome.NOT_JUDGED):
        return
    if decide(tuple(judged)).outcome is not run.outcome:
        mismatch = f"the verdict states {run.outcome}; its measurements say {decide(tuple(judged)).outcome}"
        raise StoreError(f"run {run.run}: {mismatch}", remedy=_REMEDY)


def _rejudge(measurements: Sequence[Measurement]) -> tuple[Measurement, ...]:
    bare = (replace(m, limit=None, outcome=Outcome.NOT_JUDGED) for m in measurements)
    return tuple(m if was.limit is None else m.judge(was.limit) for m, was in zip(bare, measurements, strict=True))


def _check_measurements(stored: StoredAnalysis, limits: Iterable[Limit] | None) -> None:
    """Judge measurements again by the limits of the configuration, or by their own if None."""
    if limits is None:
        judged = _rejudge(stored.measurements)
    else:
        unjudged = tuple(replace(m, limit=None, outcome=Outcome.NOT_JUDGED) for m in stored.measurements)
        judged = judge(unjudged, [replace(limit, version="") for limit in limits])
    for number, (was, expected) in enumerate(zip(stored.measurements, judged, strict=False)):
        if (was.limit, was.outcome) != (expected.limit, expected.outcome):
            raise _mismatch_error(
                stored, f"measurement {number} ({_describe_measurement(was)}) {_difference(was, expected)}"
            )
    if len(judged) > len(stored.measurements):
        not_stored = judged[len(stored.measurements)]
        raise _mismatch_error(
            stored, f"no measurement is stored for the configuration's limit of {_describe_measurement(not_stored)}"
        )


def _describe_measurement(measurement: Measurement) -> str:
    phase = f", phase {measurement.phase}" if measurement.phase else ""
    return f"{measurement.label}{phase}"


def _difference(was: Measurement, now: Measurement) -> str:
    if was.limit != now.limit:
        return f"states the limit {_bounds(was.limit)}; its configuration says {_bounds(now.limit)}"
    value = "no value" if was.value is None else f"value {was.value:g} {was.unit}"
    return f"states {was.outcome}; its {value} and limit {_bounds(was.limit)} say {now.outcome}"


def _bounds(limit: Limit | None) -> str:
    if limit is None:
        return "none"
    low = [f"at least {limit.lower:g}"] if limit.lower is not None else []
    high = [f"at most {limit.upper:g}"] if limit.upper is not None else []
    guard = [f"marginal within {limit.marginal:g}"] if limit.marginal else []
    return f"{' and '.join([*low, *high, *guard])} {limit.unit}"


def _verdict(verdict: Verdict) -> str:
    return f"{verdict.outcome} ({verdict.reason})"


def _mismatch_error(stored: StoredAnalysis, what: str) -> StoreError:
    return StoreError(f"run {stored.run}: analysis {stored.analysis}: {what}", remedy=_REMEDY)
