"""The outcome of ``cbsr-qa run --dry-run``: what a run would take, and whether the station allows it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field, InstanceOf

from cbsr_qa.app.gate.gate import gate_refusal
from cbsr_qa.app.run.outcome import PastRuns
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Page, Section
from cbsr_qa.domain.run.changes import SensorHistory
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome, gate_warnings
from cbsr_qa.report.document import Refusal
from cbsr_qa.report.station import gate_table
from cbsr_qa.report.tables import duration, plural, text_table
from cbsr_qa.station.dry_runs import DryRun

if TYPE_CHECKING:
    from cbsr_qa.station.forecasts import PressForecast


@dataclass(frozen=True, slots=True)
class PlannedPhase:
    """Expected time and content of one phase."""

    name: str
    sequence: str
    duration_s: float
    loads: int
    frames: int


@dataclass(frozen=True, slots=True)
class PlannedDecisions:
    """Presses of a phase that decides between them: fewest, those of a usual sheet, and most.

    Parameters
    ----------
    least_s, expected_s, most_s : duration of the phase with so many presses.
    floor_N : force error that remains however many presses, by noise, scatter and what all forces share.
    reached : whether a usual sheet reaches the target.
    batch_model : digest of the batch's model that says what is usual; empty without one.
    """

    phase: str
    least: int
    expected: int
    most: int
    least_s: float
    expected_s: float
    most_s: float
    floor_N: float
    reached: bool
    batch_model: str

    @classmethod
    def from_forecast(cls, forecast: "PressForecast", dry: DryRun) -> Self:
        phase = next(phase for phase in dry.phases if phase.scheduled.index == forecast.phase)
        least_s, expected_s, most_s = (
            round(phase.duration_with_s(count), 3) for count in (forecast.least, forecast.expected, forecast.most)
        )
        durations_s = {"least_s": least_s, "expected_s": expected_s, "most_s": most_s}
        return fill_from_object(
            cls, forecast, phase=phase.scheduled.name, floor_N=round(forecast.floor_N, 4), **durations_s
        )

    @property
    def words(self) -> str:
        what = "a usual sensor of the batch" if self.batch_model else "a usual sheet"
        usual = f"{self.expected} on {what}" if self.reached else f"{what} does not reach the target"
        return f"{self.least} to {self.most}, {usual}; {self.floor_N:.2g} N remain however many"


@dataclass(frozen=True, slots=True, eq=False)
class PlannedRun:
    """Cost of a run, whether the station allows it, and the sensor's earlier runs.

    Parameters
    ----------
    duration_s, least_s, expected_s : station time; of a recipe that decides between presses with the most presses,
        the fewest, and those of a usual sheet or sensor of the batch. A first rest that ends when the sheet is stable
        is longest in the first and shortest in the others.
    decides : presses of each phase that decides between them.
    spent_s : station time by kind of activity.
    peak_strain, peak_force_N : highest requested, and highest force expected.
    violations : every limit of the station that would be broken.
    warnings : plugins that could not be loaded, changes since the sensor's last run.
    gate : answers of the checks before a run.
    refused : why the run would be refused; None if it would start.
    operator : who would be stored with the run; empty if nobody is named.
    """

    duration_s: float
    least_s: float
    expected_s: float
    decides: tuple[PlannedDecisions, ...]
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
    operator: str
    dry: Annotated[InstanceOf[DryRun], Field(exclude=True)]
    history: Annotated[InstanceOf[SensorHistory], Field(exclude=True)]

    @classmethod
    def from_dry_run(
        cls,
        dry: DryRun,
        history: SensorHistory,
        failed_plugins: Iterable[object],
        gate: tuple[GateAnswer, ...] = (),
        forecasts: "Sequence[PressForecast]" = (),
        operator: str = "",
    ) -> Self:
        decides = tuple(PlannedDecisions.from_forecast(forecast, dry) for forecast in forecasts)
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
            least_s=round(dry.duration_s - dry.sooner_s - sum(d.most_s - d.least_s for d in decides), 3),
            expected_s=round(dry.duration_s - dry.sooner_s - sum(d.most_s - d.expected_s for d in decides), 3),
            decides=decides,
            spent_s={kind: round(seconds, 3) for kind, seconds in dry.spent},
            phases=tuple(
                fill_from_object(
                    PlannedPhase,
                    p.scheduled,
                    duration_s=round(p.duration_s, 3),
                    loads=p.presses,
                    frames=p.frames,
                )
                for p in dry.phases
            ),
            travel_mm=round(dry.travel_mm, 1),
            peak_force_N=round(dry.peak_force_N, 3),
            sensor_history=PastRuns.from_history(history),
            warnings=(*map(str, failed_plugins), *history.differences, *gate_warnings(gate)),
            gate=gate,
            refused=refused,
            operator=operator,
            dry=dry,
            history=history,
        )


def plan_outcome(planned: PlannedRun) -> CommandOutcome[PlannedRun]:
    """Lay out a dry run; the exit code is 2 if the run would be refused."""
    time = duration(planned.dry.duration_s)
    if planned.decides:
        least, expected = duration(planned.least_s), duration(planned.expected_s)
        time = f"{least} to {time} ({expected} on a usual sheet)"
    elif planned.dry.sooner_s:
        time = f"{duration(planned.least_s)} to {time}"
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
        ("Station time", f"{time}; at most {spent}" if planned.decides else f"{time} ({spent})"),
        *((f"Presses of {decides.phase}", decides.words) for decides in planned.decides),
        ("Loads", f"{planned.loads}, up to {peak_words} expected"),
        ("Frames", str(planned.frames)),
        ("Travel", f"{planned.dry.travel_mm / 1000:.2f} m"),
        *(("Not allowed", violation) for violation in planned.violations),
    ]
    if not planned.operator:
        facts.append(("Operator", "none named; --operator NAME stores one with the run"))
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
