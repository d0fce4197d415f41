"""Verdict that a certificate of a run rests on: that of its latest analysis, or what overrides it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.results.analyses import StoredAnalysis


@dataclass(frozen=True, slots=True)
class RunVerdict:
    """What a run is judged as now.

    Parameters
    ----------
    overridden : who overrode the verdict of the latest analysis, and why; empty without.
    reason : that, or the reason of the verdict.
    """

    outcome: Outcome
    overridden: str
    reason: str

    @classmethod
    def from_analyses(cls, store: Repository, run: str, analyses: Sequence[StoredAnalysis]) -> Self:
        """Return the verdict of the first of a run's analyses, the latest. StoreError if the run was altered."""
        latest = analyses[0]
        overrides = [one for one in store.changes.list_overrides(run) if one.analysis == latest.analysis]
        if not overrides:
            return cls(latest.verdict.outcome, "", latest.verdict.reason)
        overridden = f"overridden by {overrides[-1].by}: {overrides[-1].why}"
        return cls(overrides[-1].outcome, overridden, overridden)

    @property
    def passes(self) -> bool:
        """Whether such a run may be certified."""
        return self.outcome in (Outcome.PASS, Outcome.MARGINAL)

    @property
    def words(self) -> str:
        return f"{self.outcome}, {self.overridden}" if self.overridden else str(self.outcome)


def find_verdict_problem(store: Repository, run: str) -> str:
    """Return why a certified run could not be certified now; empty if it could. StoreError if it was altered."""
    analyses = store.analyses.load(run)
    if not analyses:
        return f"run {run} has gone on since, and has no result now"
    verdict = RunVerdict.from_analyses(store, run, analyses)
    return "" if verdict.passes else f"the verdict of its run is {verdict.outcome} now: {verdict.reason}"
