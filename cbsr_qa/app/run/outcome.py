"""The outcome of ``cbsr-qa run``: the verdict, measurements, files and the next command."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Final, Self

from pydantic import Field, InstanceOf

from cbsr_qa.analysis.run.place import run_place
from cbsr_qa.analysis.run.place_found import PlaceErrors
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.limits import Bound, FailureCode, Outcome
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.changes import ConfigurationChange, EarlierRun, SensorHistory, VerdictOverride
from cbsr_qa.domain.run.gate import GateAnswer
from cbsr_qa.domain.run.run import ChainState, PressDecided, RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import SensorPart
from cbsr_qa.report.document import ChosenParameter
from cbsr_qa.report.heads import list_codes, run_page
from cbsr_qa.report.station import gate_words

#: Most points of a force error that a terminal lists as it fell.
_MOST_POINTS: Final = 8


@dataclass(frozen=True, slots=True)
class UsedReconstruction:
    """How a run was imaged; ``weight_ratio`` is largest over smallest weight of a reading."""

    name: str
    parameter: ChosenParameter
    noise_weighting: str
    weight_ratio: float
    readings: int
    elements: int

    @classmethod
    def from_result(cls, result: RunResult) -> Self | None:
        """Return the reconstruction of a run; None if nothing was imaged."""
        run = result.observation
        if run is None:
            return None
        problem = run.reconstruction.problem
        return cls(
            run.reconstruction.method,
            ChosenParameter.from_choice(run.reconstruction.choice),
            run.settings.noise_weighting,
            run.weight_ratio,
            len(problem.reference),
            len(problem.mesh.elements),
        )


@dataclass(frozen=True, slots=True)
class PlaceCheck:
    """Whether the calibration uses the place learned from the run's presses, and the errors on which that rests."""

    used: bool
    words: str
    left_out: PlaceErrors | None
    others: PlaceErrors | None

    @classmethod
    def from_result(cls, result: RunResult) -> Self | None:
        """Return what a run's presses taught about place; None if its recipe does not ask for that."""
        run = result.observation
        if run is None or not run.settings.learn_place:
            return None
        place, issued = run_place(run), result.calibration
        return cls(issued is not None and issued.place is not None, place.words, place.left_out, place.others)


@dataclass(frozen=True, slots=True)
class MeasuredValue:
    """A measurement and the limit that judged it; absent parts are None."""

    name: str
    value: float | None
    unit: str
    uncertainty: float | None
    outcome: Outcome
    phase: str
    location: str
    trial: int | None
    load: int | None
    strain: float | None
    bound: Bound
    qualifier: str
    how: str
    lower: float | None = None
    upper: float | None = None
    marginal: float | None = None
    limits_version: str | None = None

    @classmethod
    def from_measurement(cls, measurement: Measurement) -> Self:
        limit = measurement.limit
        if limit is None:
            return fill_from_object(cls, measurement)
        bounds = {"lower": limit.lower, "upper": limit.upper, "marginal": limit.marginal}
        return fill_from_object(cls, measurement, **bounds, limits_version=limit.version or None)


@dataclass(frozen=True, slots=True)
class PastRun:
    """An earlier run of the sensor; see :class:`~cbsr_qa.domain.run.changes.EarlierRun`."""

    run: str
    started_at: datetime
    recipe: str
    batch: str
    sensor_type: str
    end: EndReason | None
    outcome: Outcome | None
    reason: str
    overridden_to: Outcome | None
    station_check: bool
    changed: str | None
    chained: bool

    @classmethod
    def from_earlier_run(cls, earlier: EarlierRun) -> Self:
        return fill_from_object(
            cls,
            earlier,
            batch=earlier.sensor.batch,
            sensor_type=earlier.sensor.sensor_type,
            end=None if earlier.changed else earlier.end,
            overridden_to=None if earlier.overridden is None else earlier.overridden[0],
            station_check=earlier.of_check,
            changed=earlier.changed or None,
        )


@dataclass(frozen=True, slots=True)
class PastRuns:
    """Runs of the sensor that began before this one, oldest first, and the number of this try of its recipe."""

    number: Annotated[int, Field(serialization_alias="try")]
    earlier_runs: tuple[PastRun, ...]

    @classmethod
    def from_history(cls, history: SensorHistory) -> Self:
        return cls(len(history.tries) + 1, tuple(map(PastRun.from_earlier_run, history.earlier)))


@dataclass(frozen=True, slots=True)
class DecidedEnd:
    """End of a phase that decides between its presses.

    Parameters
    ----------
    end : ``"target"`` if the upper bound of the force error reached the target, else ``"most presses"``.
    expected_N, upper_N : force error at the end, expected and its upper bound; None if nothing could be learned.
    floor_N : what would remain however many presses.
    """

    phase: str
    presses: int
    end: str
    expected_N: float | None
    upper_N: float | None
    floor_N: float | None

    @classmethod
    def from_event(cls, made: PressDecided, record: RunRecord) -> Self:
        name = next(phase.name for phase in record.phases if phase.index == made.phase)
        return cls(name, made.pressed, made.why, made.expected_N, made.upper_N, made.floor_N)


@dataclass(frozen=True, slots=True, eq=False)
class RunOutcome:
    """The outcome of a run.

    Parameters
    ----------
    reason : reason of the verdict.
    failure_codes : codes of what failed by the run's own recipe, the worst first.
    resume : command that resumes it; None if it finished.
    report, calibration, material : files; None if none was issued, or it could not be written (a warning says so).
    material_why : why there is no material file; empty if the recipe characterises none.
    warnings : warnings of the result and of writing the files.
    gate : answers of the checks before the run, and of those asked again when it was resumed.
    station_s, station_minutes : time the sensor occupied the station.
    presses : number of presses of all phases.
    error_by_minute : station time [min] and expected force error [N] at each decision between presses; empty for
        recipes that decide nothing.
    decided : why each phase that decides between its presses ended.
    compute_s : time of computing until the result was stored; files are written after it.
    """

    run: str
    serial: str
    parts: tuple[SensorPart, ...]
    end: EndReason
    end_detail: str
    resume: str | None
    outcome: Outcome
    reason: str
    failure_codes: tuple[FailureCode, ...]
    report: Path | None
    calibration: Path | None
    calibration_why: str
    material: Path | None
    material_why: str
    reconstruction: UsedReconstruction | None
    place: PlaceCheck | None
    measurements: tuple[MeasuredValue, ...]
    limits_version: str | None
    overrides: tuple[VerdictOverride, ...]
    gate: tuple[GateAnswer, ...]
    chain: ChainState
    changes: tuple[ConfigurationChange, ...]
    sensor_history: PastRuns | None
    warnings: tuple[str, ...]
    simulated: tuple[str, ...]
    seed: int
    station_s: float
    station_minutes: float
    presses: int
    error_by_minute: tuple[tuple[float, float], ...]
    decided: tuple[DecidedEnd, ...]
    compute_s: float
    result: Annotated[InstanceOf[RunResult], Field(exclude=True)]

    @classmethod
    def from_result(
        cls,
        result: RunResult,
        *,
        report: Path | None = None,
        calibration: Path | None = None,
        material: tuple[Path | None, str] = (None, ""),
        warnings: tuple[str, ...] = (),
        seed: int = 0,
        resume: str = "",
    ) -> Self:
        """Return the outcome of a result; ``material`` is the file, and the reason if it is missing."""
        record, verdict, version = result.record, result.verdict, result.limits_version
        return cls(
            run=record.identity.run,
            serial=record.identity.sensor.serial,
            parts=record.identity.parts,
            end=record.end,
            end_detail=record.end_detail,
            resume=resume or None,
            outcome=verdict.outcome,
            reason=verdict.reason,
            failure_codes=result.failure_codes,
            report=report,
            calibration=calibration,
            calibration_why=result.calibration_why,
            material=material[0],
            material_why=material[1],
            reconstruction=UsedReconstruction.from_result(result),
            place=PlaceCheck.from_result(result),
            measurements=tuple(map(MeasuredValue.from_measurement, result.measurements)),
            limits_version=None if version is None else version.version,
            overrides=result.overrides,
            gate=record.gate,
            chain=record.chain,
            changes=result.history.changes_in(record.identity.run),
            sensor_history=None if result.sensor_history is None else PastRuns.from_history(result.sensor_history),
            warnings=warnings,
            simulated=record.identity.simulated,
            seed=seed,
            station_s=record.station_s,
            station_minutes=round(record.station_s / 60, 3),
            presses=record.presses,
            error_by_minute=record.error_by_minute,
            decided=tuple(DecidedEnd.from_event(made, record) for made in record.decisions if made.ends),
            compute_s=sum(seconds for _, seconds in result.compute_s),
            result=result,
        )

    @property
    def exit_code(self) -> int:
        """0 passed, 1 failed, 3 aborted, broken, not measured, or a file could not be written."""
        unwritten = self.report is None or (self.result.calibration is not None and self.calibration is None)
        unwritten |= self.result.characterisation is not None and self.material is None and not self.material_why
        return self.outcome.exit_code if self.end is EndReason.FINISHED and not unwritten else 3


def _describe_decisions(record: RunRecord) -> Iterator[tuple[str, str]]:
    """What was decided between presses, and the force error as it fell."""
    for made in record.decisions:
        if made.ends:
            yield "Presses", f"{made.pressed} chosen one by one; {made.end_words}"
    if record.error_by_minute:
        step = max(1, math.ceil(len(record.error_by_minute) / _MOST_POINTS))
        shown = record.error_by_minute[::-1][::step][::-1]  # the last of them in any case
        fell = ", ".join(f"{error_N:.2g} N at {minutes:.1f} min" for minutes, error_N in shown)
        yield "Force error", f"expected {fell}"


def run_outcome(tested: RunOutcome) -> CommandOutcome[RunOutcome]:
    """Lay out the outcome of a run for a terminal; its page is the report."""
    result, identity = tested.result, tested.result.record.identity
    tries = "" if result.sensor_history is None else result.sensor_history.words
    facts = [
        *([("Sensor", tries)] if tries else []),
        *list_codes(result.failure_codes),
        ("Run", f"{identity.words}, by {identity.operator}" if identity.operator else identity.words),
        ("Time", f"{tested.station_s / 60:.1f} min of station time, {tested.compute_s:.1f} s to compute the result"),
        *_describe_decisions(result.record),
        ("Stored rows", tested.chain.words),
        *([("Gate", gate)] if (gate := gate_words(tested.gate)) else []),
    ]
    printed = [("Report", str(tested.report or "none"))]
    if tested.calibration is None:
        facts.append(("Calibration", f"none: {result.calibration_words or 'not written'}"))
    else:
        printed.append(("Calibration", str(tested.calibration)))
        if result.calibration is not None and result.calibration.signature is not None:
            facts.append(("Signed", f"the calibration, by {result.calibration.signature.words}"))
    if tested.place is not None:
        facts.append(("Place", tested.place.words.removeprefix("Place ")))
    if tested.material is not None:
        printed.append(("Material", str(tested.material)))
    elif tested.material_why:
        facts.append(("Material", f"none: {tested.material_why}"))
    if tested.resume:
        printed.append(("Continue with", tested.resume))
    page = run_page(result)
    if tested.end is not EndReason.FINISHED:
        page = replace(page, banner=replace(page.banner, headline=tested.end.upper(), reason=tested.reason))
    page = replace(page, identity=tuple(facts), warnings=tested.warnings, printed=tuple(printed))
    return CommandOutcome(tested, page, exit_code=tested.exit_code)
