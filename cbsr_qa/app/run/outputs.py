"""Files a run writes besides the database: calibration and report."""

from pathlib import Path

from cbsr_qa.app.run.outcome import RunOutcome
from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.config.paths import calibrations_folder, reports_folder
from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.domain.plan.plan import Recipe
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.report.render import render_run, report_name, write_report
from cbsr_qa.report.section import Annexes, load_sections
from cbsr_qa.system.clock import Stages

_AGAIN = "cbsr-qa report writes it again once there is room"


def write_outputs(
    result: RunResult, recipe: Recipe, plugins: Plugins, stages: Stages, seed: int, *, resume: str = ""
) -> RunOutcome:
    """Write calibration, material and report, and tell plugins of the calibration; failures become warnings."""
    identity = result.record.identity
    calibration: Path | None = None
    failures: list[str] = []
    if result.calibration is not None:
        calibration = calibration_path(identity)
        with stages.stage("writing the calibration file"):
            calibration = _write_calibration_file(result.calibration, calibration, failures)
        plugins.tell("cbsr_calibration_issued", failures.append, calibration=result.calibration)
    material = _material(result, failures)
    report = reports_folder() / report_name(identity.sensor.serial, identity.run)
    annexes = Annexes.from_recipe(recipe, result.verdict.outcome)
    sections, missing_sections = load_sections(annexes.list_sections(plugins), plugins)
    html = ""
    with stages.stage("rendering the report"):
        html = render_run(result, sections, warnings=(*missing_sections, *failures))
    report_file = _write_report_file(report, html, failures)
    return RunOutcome.from_result(
        result,
        report=report_file,
        calibration=calibration,
        material=material,
        warnings=(*result.warnings, *missing_sections, *failures),
        seed=seed,
        resume=resume,
    )


def _material(result: RunResult, failed: list[str]) -> tuple[Path | None, str]:
    if result.characterisation is None:
        return None, ""
    from cbsr_qa.app.run.material_output import why_no_material, write_material  # other runs issue no material

    reason = why_no_material(result)
    if reason:
        return None, reason
    try:
        return write_material(result), ""
    except CbsrError as error:
        failed.append(f"the material file could not be written: {error.reason}; {_AGAIN}")
        return None, ""


def calibration_path(identity: RunIdentity) -> Path:
    """Return the path of a run's calibration file."""
    name = report_name(identity.sensor.serial, identity.run)  # safe for any serial of an old database
    return calibrations_folder() / Path(name).with_suffix(".h5")


def _write_calibration_file(calibration: Calibration, path: Path, failed: list[str]) -> Path | None:
    try:
        write_calibration(path, calibration)
    except CbsrError as error:
        failed.append(f"the calibration is stored, but its file could not be written: {error.reason}; {_AGAIN}")
        return None
    return path


def _write_report_file(path: Path, html: str, failed: list[str]) -> Path | None:
    try:
        write_report(path, html)
    except CbsrError as error:
        failed.append(f"the report could not be written: {error.reason}; {_AGAIN}")
        return None
    return path
