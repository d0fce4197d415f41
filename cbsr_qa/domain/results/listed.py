"""Runs as a shift lists them: one line a run with its verdict, overrides included, and the limits it failed."""

from dataclasses import dataclass
from datetime import datetime
from typing import Final

from cbsr_qa.domain.plan.limits import FailureCode, Outcome, select_failure_codes
from cbsr_qa.domain.results.fleet import MetricKey
from cbsr_qa.domain.run.run import UNCHAINED, ChainState
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import SensorPart

#: Word in place of a verdict, where a run does not match its chain.
ALTERED: Final = "altered"


@dataclass(frozen=True, slots=True)
class Decision:
    """An operator's decision against a verdict."""

    outcome: Outcome
    operator: str
    why: str


@dataclass(frozen=True, slots=True)
class ListedRun:
    """One run in a list.

    Parameters
    ----------
    run : identifier; sorted as text, runs are in the order they were made in.
    started_at : start by the station's clock.
    end : RUNNING if it was cut off or is in progress.
    station_s : station time until its last session began or ended [s].
    outcome, reason : outcome and reason of its latest analysis after its last session; None and empty where it has
        none.
    decision : the latest override of that analysis; None where there is none.
    failed : metrics outside their limits in that analysis, each once, the worst first.
    earlier : finished runs of the sensor and recipe made before this one, checks of stations not counted.
    of_check : whether the run is a golden sensor's, made to check its station.
    simulated : whether anything was simulated.
    end_detail : person who aborted it, or what broke it.
    chain : state of its chain.
    altered : description of what does not match the chain, also its ``reason`` then; it has no outcome and no
        verdict. Empty where nothing does.
    coded : all failure codes of its recipe; not read where its outcome has none.
    parts : parts of its sensor; none where it was altered.
    failed_before : codes of earlier failures of the sensor and recipe, as often as each was given; empty unless it
        failed.
    failures : number of measurements outside their limits in that analysis, each place of a sheet counted.
    """

    run: str
    serial: str
    batch: str
    sensor_type: str
    station: str
    recipe: str
    operator: str
    started_at: datetime
    end: EndReason
    station_s: float
    outcome: Outcome | None
    reason: str
    decision: Decision | None
    failed: tuple[MetricKey, ...]
    earlier: int
    of_check: bool
    simulated: bool
    end_detail: str = ""
    chain: ChainState = UNCHAINED
    altered: str = ""
    coded: tuple[FailureCode, ...] = ()
    parts: tuple[SensorPart, ...] = ()
    failed_before: tuple[str, ...] = ()
    failures: int = 0

    @property
    def failure_codes(self) -> tuple[FailureCode, ...]:
        """Codes of what the run failed, the worst first, whether the verdict was overridden or not."""
        failed = [(key.name, key.phase, key.qualifier) for key in self.failed]
        if self.altered:
            return ()
        return select_failure_codes(self.coded, self.outcome, str(self.end), failed, self.failed_before)

    @property
    def finished(self) -> bool:
        return self.end is EndReason.FINISHED

    @property
    def verdict(self) -> Outcome | None:
        """What counts: the override if there is one, else the outcome; None if it did not finish, or was altered."""
        if not self.finished or self.altered:
            return None
        return self.outcome if self.decision is None else self.decision.outcome

    @property
    def passed(self) -> bool:
        return self.verdict in (Outcome.PASS, Outcome.MARGINAL)
