"""What a run leaves behind besides the database: its calibration file, its report, and its document.

Commands that go on with something stored, as a user types them; a database that is not the usual one is named.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cbsr_qa.app.analyse import parameter_document
from cbsr_qa.app.changes import change_row
from cbsr_qa.app.run.material_output import why_no_material, write_material
from cbsr_qa.calibration.file import write_calibration
from cbsr_qa.config import calibrations_folder, database_url, reports_folder
from cbsr_qa.domain import CbsrError
from cbsr_qa.domain.plan import Recipe
from cbsr_qa.domain.results import Calibration, EndReason, Measurement, Outcome, RunResult, explained
from cbsr_qa.domain.run import RunIdentity, SensorHistory
from cbsr_qa.plugin import Kind, Plugins, ReportSection, failure
from cbsr_qa.report import render_run, report_name, write_report
from cbsr_qa.store import Repository
from cbsr_qa.system import Stages


def resume_command(run: str, store: Repository) -> str:
    """Return what goes on with a run."""
    return f"cbsr-qa run --resume {run}{database_option(store)}"


def report_command(run: str, store: Repository) -> str:
    """Return what writes a run's report and calibration file again."""
    return f"cbsr-qa report {run}{database_option(store)}"


def database_option(store: Repository) -> str:
    """Return the option that names a database, after a blank; empty where it is found without."""
    if store.is_at(database_url()):
        return ""
    return f" --database {store.address}"


_AGAIN = "cbsr-qa report writes it again once there is room"

_HEADLINES = {
    Outcome.PASS: "PASS",
    Outcome.MARGINAL: "MARGINAL PASS",
    Outcome.FAIL: "FAIL",
    Outcome.NOT_MEASURED: "NOT MEASURED",
    Outcome.NOT_JUDGED: "NOT JUDGED",
}


@dataclass(frozen=True, slots=True, eq=False)
class RunOutcome:
    """What came of a run, for whoever asked for it.

    Parameters
    ----------
    result : everything concluded.
    report, calibration, material : files; None where none was issued, or it could not be written (a warning says so).
    material_why : why there is no material file; empty where the recipe characterises none.
    resume : what to type to go on with it; empty where it finished.
    warnings : those of the result and of writing the files.
    """

    result: RunResult
    report: Path | None
    calibration: Path | None
    warnings: tuple[str, ...]
    compute_s: float
    seed: int
    material: Path | None = None
    material_why: str = ""
    resume: str = ""

    @property
    def run(self) -> str:
        """Identifier of the run."""
        return self.result.record.identity.run

    @property
    def headline(self) -> str:
        """The verdict in capitals; how the run ended where it did not finish."""
        end = self.result.record.end
        return _HEADLINES[self.result.verdict.outcome] if end is EndReason.FINISHED else str(end).upper()

    @property
    def reason(self) -> str:
        """What decided it; of a failed run also how many limits fail."""
        return explained(self.result.verdict, self.result.measurements)

    @property
    def calibration_why(self) -> str:
        """Why there is no calibration."""
        return self.result.calibration_why

    @property
    def station_s(self) -> float:
        """Time the sensor occupied the station [s]."""
        return self.result.record.station_s

    @property
    def simulated(self) -> tuple[str, ...]:
        """What was simulated, in words."""
        return self.result.record.identity.simulated

    @property
    def sensor_history(self) -> SensorHistory | None:
        """Runs of the sensor that began before this one."""
        return self.result.sensor_history

    @property
    def exit_code(self) -> int:
        """0 passed, 1 failed, 3 aborted, broken, not measured, or a file could not be written."""
        finished = self.result.record.end is EndReason.FINISHED
        unwritten = self.report is None or (self.result.calibration is not None and self.calibration is None)
        unwritten |= self.result.characterisation is not None and self.material is None and not self.material_why
        return self.result.verdict.outcome.exit_code if finished and not unwritten else 3

    def document(self) -> dict[str, Any]:
        """Return the outcome as one JSON document."""
        record = self.result.record
        return {
            "run": self.run,
            "serial": record.identity.sensor.serial,
            "end": str(record.end),
            "end_detail": record.end_detail,
            "resume": self.resume or None,
            "outcome": str(self.result.verdict.outcome),
            "reason": self.result.verdict.reason,
            "report": None if self.report is None else str(self.report),
            "calibration": None if self.calibration is None else str(self.calibration),
            "calibration_why": self.calibration_why,
            "material": None if self.material is None else str(self.material),
            "material_why": self.material_why,
            "reconstruction": reconstruction_row(self.result),
            "measurements": [measurement_row(m) for m in self.result.measurements],
            "limits_version": None if self.result.limits_version is None else self.result.limits_version.version,
            "overrides": [override.document() for override in self.result.overrides],
            "chain": record.chain.document(),
            "changes": [change_row(change) for change in self.result.history.of(self.run)],
            "sensor_history": None if self.sensor_history is None else self.sensor_history.document(),
            "warnings": list(self.warnings),
            "simulated": list(self.simulated),
            "seed": self.seed,
            "station_s": self.station_s,
            "compute_s": self.compute_s,
        }


def reconstruction_row(result: RunResult) -> dict[str, Any] | None:
    """Return how a run was imaged: method, regularisation parameter, weighting; None where nothing was."""
    run = result.observation
    if run is None:
        return None
    made = run.reconstruction
    return {
        "name": made.method,
        "parameter": parameter_document(made.choice),
        "noise_weighting": run.settings.noise_weighting,
        "weight_ratio": run.weight_ratio,
        "readings": len(made.problem.reference),
        "elements": len(made.problem.mesh.elements),
    }


def measurement_row(measurement: Measurement) -> dict[str, Any]:
    """Return a measurement as a JSON object; what it does not have is null."""
    limit = measurement.limit
    return {
        "name": measurement.name,
        "value": measurement.value,
        "unit": measurement.unit,
        "uncertainty": measurement.uncertainty,
        "lower": limit.lower if limit else None,
        "upper": limit.upper if limit else None,
        "marginal": limit.marginal if limit else None,
        "limits_version": (limit.version or None) if limit else None,
        "outcome": str(measurement.outcome),
        "phase": measurement.phase,
        "location": measurement.location,
        "trial": measurement.trial,
        "load": measurement.load,
        "strain": measurement.strain,
        "bound": str(measurement.bound),
        "qualifier": measurement.qualifier,
        "how": measurement.how,
    }


def write_outputs(
    result: RunResult, recipe: Recipe, plugins: Plugins, stages: Stages, seed: int, *, resume: str = ""
) -> RunOutcome:
    """Write calibration file and report, and tell plugins of the calibration.

    What cannot be written becomes a warning: the run and what was concluded from it are stored already, and
    ``cbsr-qa report`` writes both files again.
    """
    identity = result.record.identity
    calibration: Path | None = None
    failed: list[str] = []
    if result.calibration is not None:
        calibration = calibration_path(identity)
        with stages.stage("writing the calibration file"):
            calibration = _exported(result.calibration, calibration, failed)
        plugins.tell("cbsr_calibration_issued", failed.append, calibration=result.calibration)
    material, material_why = _material(result, failed)
    report = reports_folder() / report_name(identity.sensor.serial, identity.run)
    sections, missing = report_sections(recipe.sections, plugins)
    html = ""
    with stages.stage("rendering the report"):
        html = render_run(result, sections, warnings=(*missing, *failed))
    written = _written(report, html, failed)
    warnings = (*result.warnings, *missing, *failed)
    return RunOutcome(result, written, calibration, warnings, stages.total_s(), seed, material, material_why, resume)


def _material(result: RunResult, failed: list[str]) -> tuple[Path | None, str]:
    """Write the material file of a characterisation that passed."""
    if result.characterisation is None:
        return None, ""
    why = why_no_material(result)
    if why:
        return None, why
    try:
        return write_material(result), ""
    except CbsrError as error:
        failed.append(f"the material file could not be written: {error.reason}; {_AGAIN}")
        return None, ""


def calibration_path(identity: RunIdentity) -> Path:
    """Where the calibration file of a run lies."""
    name = report_name(identity.sensor.serial, identity.run)  # safe whatever a serial of an old database holds
    return calibrations_folder() / Path(name).with_suffix(".h5")


def _exported(calibration: Calibration, path: Path, failed: list[str]) -> Path | None:
    try:
        write_calibration(path, calibration)
    except CbsrError as error:
        failed.append(f"the calibration is stored, but its file could not be written: {error.reason}; {_AGAIN}")
        return None
    return path


def _written(path: Path, html: str, failed: list[str]) -> Path | None:
    try:
        write_report(path, html)
    except CbsrError as error:
        failed.append(f"the report could not be written: {error.reason}; {_AGAIN}")
        return None
    return path


def report_sections(names: tuple[str, ...], plugins: Plugins) -> tuple[list[ReportSection], list[str]]:
    """Return the sections a recipe asks for, every installed one where it names none.

    Built-in sections come in the order they are registered in, others behind them by name.

    Returns
    -------
    The sections, and a warning for each that could not be loaded.
    """
    sections: list[ReportSection] = []
    missing: list[str] = []
    for name in names or plugins.in_order(Kind.SECTION):
        try:
            sections.append(plugins.factory(Kind.SECTION, name)())
        except BaseException as error:  # noqa: BLE001 - a stranger's constructor may raise anything
            missing.append(f"The report section {name} is left out: {failure(error)}")
    return sections, missing
