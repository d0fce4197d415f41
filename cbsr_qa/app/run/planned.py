"""The outcome of ``cbsr-qa run --dry-run``: what a run would take, and whether the station allows it."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Self

from pydantic import Field, InstanceOf

from cbsr_qa.app.gate.gate import gate_refusal
from cbsr_qa.app.run.outcome import PastRuns
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Page, Section
from cbsr_qa.domain.run.changes import SensorHistory
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome, gate_warnings
from cbsr_qa.report.document import Refusal
from cbsr_qa.report.gate import gate_table
from cbsr_qa.report.tables import duration, plural, text_table
from cbsr_qa.station.dry_runs import DryRun


@dataclass(frozen=True, slots=True)
class PlannedPhase:
    """Expected time and content of one phase."""

    name: str
    sequence: str
    duration_s: float
    loads: int
    frames: int


@dataclass(frozen=True, slots=True, eq=False)
class PlannedRun:
    """Cost of a run, whether the station allows it, and the sensor's earlier runs.

    Parameters
    ----------
    spent_s : station time by kind of activity.
    peak_strain, peak_force_N : highest requested, and highest force expected.
    violations : every limit of the station that would be broken.
    warnings : plugins that could not be loaded, changes since the sensor's last run.
    gate : answers of the checks before a run.
    refused : why the run would be refused; None if it would start.
    """

    duration_s: float
    spent_s: dict[str, float]
    phases: tuple[PlannedPhase, ...]
    loads: int
    frames: int
    travel_mm: float
    peak_strain: float
    peak_force_N: float
    violations: tuple[str, ...]
    sensor_history: PastRuns
    warnings: tuple[str, ...]
    gate: tuple[GateAnswer, ...]
    refused: Refusal | None
    dry: Annotated[InstanceOf[DryRun], Field(exclude=True)]
    history: Annotated[InstanceOf[SensorHistory], Field(exclude=True)]

    @classmethod
    def from_dry_run(
        cls, dry: DryRun, history: SensorHistory, failed_plugins: Iterable[object], gate: tuple[GateAnswer, ...] = ()
    ) -> Self:
        refused = None
        try:
            if (error := gate_refusal(gate)) is not None:
                raise error
            dry.refuse()
        except RefusedError as error:
            refused = fill_from_object(Refusal, error)
        return fill_from_object(
            cls,
            dry,
            duration_s=round(dry.duration_s, 3),
            spent_s={kind: round(seconds, 3) for kind, seconds in dry.spent},
            phases=tuple(
                fill_from_object(PlannedPhase, p.scheduled, duration_s=round(p.duration_s, 3), frames=p.frames)
                for p in dry.phases
            ),
            travel_mm=round(dry.travel_mm, 1),
            peak_force_N=round(dry.peak_force_N, 3),
            sensor_history=PastRuns.from_history(history),
            warnings=(*map(str, failed_plugins), *history.differences, *gate_warnings(gate)),
            gate=gate,
            refused=refused,
            dry=dry,
            history=history,
        )


def plan_outcome(planned: PlannedRun) -> CommandOutcome[PlannedRun]:
    """Lay out a dry run; the exit code is 2 if the run would be refused."""
    time = duration(planned.dry.duration_s)
    banner = Banner("pass", "✓", "The station allows this run", f"{time} of station time; nothing has moved")
    if planned.refused is not None:
        reasons = (
            [f"it breaks {plural(len(planned.violations), 'limit')} of the station"] if planned.violations else []
        )
        if any(answer.outcome is GateOutcome.REFUSED for answer in planned.gate):
            reasons.insert(0, "the gate refuses it")
        banner = Banner("fail", "✗", "This run would be refused", "; ".join(reasons))
    spent = ", ".join(f"{kind} {duration(seconds)}" for kind, seconds in planned.dry.spent)
    peak_words = f"{100 * planned.peak_strain:g} % strain and {planned.dry.peak_force_N:.3g} N"
    facts = [
        ("Station time", f"{time} ({spent})"),
        ("Loads", f"{planned.loads}, up to {peak_words} expected"),
        ("Frames", str(planned.frames)),
        ("Travel", f"{planned.dry.travel_mm / 1000:.2f} m"),
        *(("Not allowed", violation) for violation in planned.violations),
    ]
    if planned.history.words:
        facts.append(("Sensor", planned.history.words))
    rows = [(p.name, p.sequence, duration(p.duration_s), str(p.loads), str(p.frames)) for p in planned.phases]
    phases = text_table("Expected time and content.", ("phase", "sequence", "time", "loads", "frames"), rows, (3, 4))
    page = Page("Dry run", planned.history.sensor.serial, banner, tuple(facts), warnings=planned.warnings)
    asked_checks = [answer for answer in planned.gate if answer.outcome is not GateOutcome.OFF]
    gate = (
        [Section("Gate", (gate_table("Asked before the run; those that are off are left out.", asked_checks),))]
        if asked_checks
        else []
    )
    return CommandOutcome(planned, page, (Section("Phases", (phases,)), *gate), 0 if planned.refused is None else 2)
