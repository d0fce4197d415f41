"""Files a run writes besides the database: calibration and report."""

from pathlib import Path

from cbsr_qa.app.run.material_output import why_no_material, write_material
from cbsr_qa.app.run.outcome import RunOutcome
from cbsr_qa.calibration.file import write_calibration
from cbsr_qa.config import calibrations_folder, reports_folder
from cbsr_qa.domain import CbsrError
from cbsr_qa.domain.plan import Recipe
from cbsr_qa.domain.results import Calibration, RunResult
from cbsr_qa.domain.run import RunIdentity
from cbsr_qa.plugin import Kind, Plugins, ReportSection, failure
from cbsr_qa.report import render_run, report_name, write_report
from cbsr_qa.system import Stages, come_back_once

_AGAIN = "cbsr-qa report writes it again once there is room"


def write_outputs(
    result: RunResult, recipe: Recipe, plugins: Plugins, stages: Stages, seed: int, *, resume: str = ""
) -> RunOutcome:
    """Write calibration, material and report, and tell plugins of the calibration; failures become warnings."""
    identity = result.record.identity
    calibration: Path | None = None
    failed: list[str] = []
    if result.calibration is not None:
        calibration = calibration_path(identity)
        with stages.stage("writing the calibration file"):
            calibration = _exported(result.calibration, calibration, failed)
        plugins.tell("cbsr_calibration_issued", failed.append, calibration=result.calibration)
    material = _material(result, failed)
    report = reports_folder() / report_name(identity.sensor.serial, identity.run)
    sections, missing = report_sections(recipe.sections, plugins)
    html = ""
    with stages.stage("rendering the report"):
        html = render_run(result, sections, warnings=(*missing, *failed))
    written = _written(report, html, failed)
    return RunOutcome.of(
        result,
        report=written,
        calibration=calibration,
        material=material,
        warnings=(*result.warnings, *missing, *failed),
        seed=seed,
        resume=resume,
    )


def _material(result: RunResult, failed: list[str]) -> tuple[Path | None, str]:
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
    """Return the path of a run's calibration file."""
    name = report_name(identity.sensor.serial, identity.run)  # safe for any serial of an old database
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
    """Return the named sections (all installed ones if none are named), and a warning for each that failed to load.

    Built-in sections come first, in the order of their registration, then others by name.
    """
    sections: list[ReportSection] = []
    missing: list[str] = []
    for name in names or plugins.in_order(Kind.SECTION):
        try:
            with come_back_once():
                sections.append(plugins.factory(Kind.SECTION, name)())
        except BaseException as error:  # noqa: BLE001 - a stranger's constructor may raise anything
            missing.append(f"The report section {name} is left out: {failure(error)}")
    return sections, missing
