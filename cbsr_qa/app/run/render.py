"""Reports rendered again from the store."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from pydantic import Field, InstanceOf

from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.analysis.strip_cycles import characterise_run
from cbsr_qa.app.command_hints import resume_command
from cbsr_qa.app.run.decided_again import check_decided, judging_recipe
from cbsr_qa.app.run.material_output import material_path, why_no_material, write_material
from cbsr_qa.app.run.outcome import RunOutcome
from cbsr_qa.app.run.outputs import calibration_path
from cbsr_qa.app.station_charts import charts_after
from cbsr_qa.calibration.file.hdf5 import calibration_of, write_calibration
from cbsr_qa.config.merging import restore
from cbsr_qa.config.paths import database_url, reports_folder
from cbsr_qa.domain.errors import CalibrationError, NumericsError
from cbsr_qa.domain.plan.limits import FailureCode, Limit, Outcome
from cbsr_qa.domain.plan.plan import Recipe
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.characterisation import Characterisation
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.changes import VerdictOverride
from cbsr_qa.domain.run.gate import GateAnswer
from cbsr_qa.domain.run.run import ChainState, RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.report.heads import list_codes, run_page
from cbsr_qa.report.render import render_run, report_name, write_report
from cbsr_qa.report.section import Annexes, load_sections
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.results.analyses import StoredAnalysis
from cbsr_qa.system.clock import write_local_time


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """The rendered page, its path, and its warnings."""

    run: str
    serial: str
    outcome: Outcome
    reason: str
    failure_codes: tuple[FailureCode, ...]
    report: Path
    chain: ChainState
    overrides: tuple[VerdictOverride, ...]
    gate: tuple[GateAnswer, ...]
    warnings: tuple[str, ...]
    result: Annotated[InstanceOf[RunResult], Field(exclude=True)]


def render_stored(
    run_or_serial: str,
    *,
    database: str | None = None,
    folder: Path | None = None,
    annexes: Sequence[str] = (),
) -> Rendered:
    """Render the report of a stored run again, and write its calibration and material files if they are gone.

    Parameters
    ----------
    run_or_serial : a run, or a serial number for its latest run.
    database : URL or path; None for ``CBSR_QA_DATABASE`` or the default.
    folder : folder to write to; None for the reports folder in ``var/``.
    annexes : names of the sections that are printed as annexes, or ``all`` or ``none``; by default those that the
        recipe names are there, folded.

    Raises
    ------
    StoreError
        If database, run or sensor does not exist, or the run was altered.
    RefusedError
        If the folder cannot be written to, or an annex does not exist; nothing was written then.
    """
    plugins = discover()
    asked = Annexes.from_request(annexes, plugins) if annexes else None
    with open_store(database_url(database), create=False) as store:
        run = store.runs.resolve(run_or_serial)
        result, recipe = rebuilt(run, store, plugins)
    path = calibration_path(result.record.identity)
    if result.calibration is not None and not path.exists():
        write_calibration(path, result.calibration)
    if not why_no_material(result) and not material_path(result).exists():
        write_material(result)
    wanted = asked or Annexes.from_recipe(recipe, result.verdict.outcome)
    return render_result(result, wanted, plugins, folder or reports_folder())


def render_result(result: RunResult, annexes: Annexes, plugins: Plugins, folder: Path) -> Rendered:
    """Render one run's report to ``<serial>-<run>.html``, the name the run itself gave it.

    Raises
    ------
    RefusedError
        If the folder cannot be written to; nothing was written then.
    """
    identity = result.record.identity
    loaded_sections, missing_sections = load_sections(annexes.list_sections(plugins), plugins)
    path = folder / report_name(identity.sensor.serial, identity.run)
    write_report(path, render_run(result, loaded_sections, warnings=missing_sections, opened=annexes.opened))
    return Rendered(
        identity.run,
        identity.sensor.serial,
        result.verdict.outcome,
        result.verdict.reason,
        result.failure_codes,
        path,
        result.record.chain,
        result.overrides,
        result.record.gate,
        tuple(dict.fromkeys((*result.warnings, *missing_sections))),
        result,
    )


def render_outcome(rendered: Rendered) -> CommandOutcome[Rendered]:
    """Lay out a run's rendered report and its verdict."""
    page = run_page(rendered.result)
    named = ("Run", rendered.result.record.identity.words)
    facts = (named, *list_codes(rendered.failure_codes), ("Stored rows", rendered.chain.words))
    printed = (("Report", str(rendered.report)),)
    page = replace(page, identity=facts, warnings=rendered.warnings, printed=printed)
    return CommandOutcome(rendered, page, exit_code=3 if rendered.result.missing else 0)


def outcome_of_stored(run: str, store: Repository, plugins: Plugins) -> RunOutcome:
    """Return the outcome of a stored run without imaging it: ``reconstruction`` and ``place`` are None.

    Files are named where they are in ``var/``.

    Raises
    ------
    StoreError
        If the run was altered.
    """
    result, _ = rebuilt(run, store, plugins, imaged=False)
    identity = result.record.identity
    report = reports_folder() / report_name(identity.sensor.serial, identity.run)
    calibration = calibration_path(identity)
    no_material_reason = "" if result.characterisation is None else why_no_material(result)
    material = None if result.characterisation is None or no_material_reason else material_path(result)
    return RunOutcome.from_result(
        result,
        report=report if report.exists() else None,
        calibration=calibration if result.calibration is not None and calibration.exists() else None,
        material=(material if material is not None and material.exists() else None, no_material_reason),
        warnings=result.warnings,
        seed=restore(store.runs.read_configuration(run)).seed,
        resume=resume_command(run, store) if result.missing or result.record.end is not EndReason.FINISHED else "",
    )


def rebuilt(run: str, store: Repository, plugins: Plugins, *, imaged: bool = True) -> tuple[RunResult, Recipe]:
    """Rebuild the result of a stored run.

    Measurements, verdict and calibration are those of the latest stored analysis; images are computed again from the
    stored frames and configuration. A run that was not analysed since its last session is not analysed here: its
    result says that none is stored, and how to get one.

    Parameters
    ----------
    imaged : whether to compute the images of a run whose analysis is stored, which takes seconds.

    Returns
    -------
    The result, and the recipe that judged it.
    """
    record, analyses = store.runs.load(run), store.analyses.load(run)
    stored = next(iter(analyses), None)
    recipe = judging_recipe(store, run, stored)
    check = store.stations.read_latest_check(record.identity.station, record.identity.started_at)
    history = store.changes.read_history(record)
    sensor_history = store.sensors.read_history(record.identity.sensor, record.identity.recipe, run)
    coded = restore(store.runs.read_configuration(run)).recipe.failure_codes
    failed_before = store.lists.read_failed_before(run) if sensor_history.failed_runs else ()
    if stored is None:
        without_result = _describe_unanalysed(record, resume_command(run, store))
        return replace(
            without_result,
            station_check=check,
            history=history,
            sensor_history=sensor_history,
            coded=coded,
            failed_before=failed_before,
        ), recipe
    check_decided(record, stored, recipe.limits)
    observation, characterisation, no_images_reason = _analyse_frames(record, recipe, plugins if imaged else None)
    calibration, unreadable_reason = _calibration(store, stored)
    result = RunResult(
        record=record,
        observation=observation,
        measurements=with_versions(stored.measurements, recipe.limits),
        verdict=stored.verdict,
        calibration=calibration,
        calibration_why=unreadable_reason or stored.calibration_why,
        compute_s=stored.compute_s,
        warnings=tuple(
            dict.fromkeys(
                (
                    *_adoption_notes(analyses, recipe.name),
                    *stored.warnings,
                    *filter(None, [no_images_reason]),
                    *record.chain.warnings,
                    *sensor_history.changed,
                    *history.warnings,
                )
            )
        ),
        limits_version=recipe.limits_version,
        characterisation=characterisation,
        station_check=check,
        station_charts=charts_after(store, record.identity.station, until=stored.analysis),
        history=history,
        overrides=store.changes.list_overrides(run),
        sensor_history=sensor_history,
        coded=coded,
        failed_before=failed_before,
    )
    return result, recipe


def _analyse_frames(
    record: RunRecord, recipe: Recipe, plugins: Plugins | None
) -> tuple[RunObservation | None, Characterisation | None, str]:
    """Compute images, or the material of a strip, from the stored frames; otherwise return a reason.

    Without plugins nothing is imaged.
    """
    if record.end is not EndReason.FINISHED:
        return None, None, ""
    try:
        if recipe.characterisation is not None:
            return None, characterise_run(record, recipe.characterisation), ""
    except NumericsError as error:
        return None, None, f"the material cannot be characterised: {error.reason}"
    if plugins is None or all(phase.frames is None for phase in record.phases):
        return None, None, "" if plugins is None else "the run holds no frames, so that there are no images"
    reconstruction = create_plugin(plugins, Kind.RECONSTRUCTION, recipe.reconstruction, "[reconstruction]")
    try:
        return observe_run(record, reconstruction, recipe.analysis), None, ""
    except NumericsError as error:
        return None, None, f"the frames cannot be imaged: {error.reason}"


def _calibration(store: Repository, stored: StoredAnalysis) -> tuple[Calibration | None, str]:
    """Load the calibration an analysis issued, or say why it cannot be shown."""
    if stored.calibration is None:
        return None, ""
    file, digest = store.calibrations.load_file(stored.calibration)
    try:
        return calibration_of(file, issued=digest), ""
    except CalibrationError as error:
        return None, f"{stored.calibration} was issued, but cannot be shown by this version: {error.reason}"


def _describe_unanalysed(record: RunRecord, resume: str) -> RunResult:
    """Return what is known of a run that has no stored analysis: nothing that reads like a verdict."""
    is_finished = record.end is EndReason.FINISHED
    ended = f"the run was {record.end}: {record.end_detail}".removesuffix(": ")
    no_result = f"no result is stored; to {'compute and store it' if is_finished else 'continue the run'}: {resume}"
    return RunResult(
        record=record,
        observation=None,
        measurements=(),
        verdict=Verdict(Outcome.NOT_MEASURED, no_result if is_finished else ended),
        calibration=None,
        calibration_why="no result is stored",
        warnings=(*(() if is_finished else (no_result,)), *record.chain.warnings),
        missing=True,
    )


def with_versions(measurements: Iterable[Measurement], limits: Iterable[Limit]) -> tuple[Measurement, ...]:
    """Restore the versions of stored measurements' limits, which only the recipe states."""
    versions = {replace(limit, version=""): limit.version for limit in limits}
    return tuple(
        m if m.limit is None else replace(m, limit=replace(m.limit, version=versions.get(m.limit, "")))
        for m in measurements
    )


def _adoption_notes(analyses: Sequence[StoredAnalysis], recipe: str) -> Iterator[str]:
    """Yield what a reader must know of an adopted analysis, the first of all."""
    adoption = analyses[0].adoption
    if adoption is None:
        return
    decided = f"adopted by {adoption.operator} on {write_local_time(adoption.adopted_at)}: {adoption.why}"
    yield f"The verdict and all values are of a re-analysis by recipe {recipe!r}, {decided}. Earlier ones are kept."
    for stored in analyses:
        if stored.calibration is not None:
            yield f"Calibration {stored.calibration}, which an earlier analysis of this run issued, is still stored."
