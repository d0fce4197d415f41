"""Conclusion of a run: it is read back, evaluated and stored; report and calibration file are written."""

import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from cbsr_qa.analysis.evaluate import calibrate_run, evaluate_run
from cbsr_qa.app.command_hints import report_command, resume_command
from cbsr_qa.app.run.outcome import RunOutcome
from cbsr_qa.app.run.outputs import write_outputs
from cbsr_qa.app.run.preflight import station_key
from cbsr_qa.app.run.stopping import stoppable
from cbsr_qa.app.station_charts import charts_after
from cbsr_qa.calibration.file.hdf5 import sign_calibration
from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.errors import AbortedError, BrokenRunError, RefusedError, StoreError, UnconcludedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.changes import NO_REASON, ConfigurationChange
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.discovery import Plugins, name_left_threads
from cbsr_qa.report.tables import duration
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.types import time_of_id
from cbsr_qa.system.clock import RealClock, Stages, write_local_time

#: Time that the computation of a result may take to stop [s]; numerical libraries hear nothing within a call.
_STOPS_WITHIN_S: Final = 30.0


def conclude_run(
    run: str,
    store: Repository,
    configuration: Configuration,
    plugins: Plugins,
    stages: Stages,
    warnings: Sequence[str],
) -> RunOutcome:
    """Evaluate a stored run, and write its report and calibration file.

    Raises
    ------
    BrokenRunError
        If the result could not be stored or read back, or its calibration not be signed; the run's rows are kept.
    UnconcludedError
        If a signal or the keyboard stopped it.
    """
    try:
        with concluding(run, store):
            return _conclude(run, store, configuration, plugins, stages, warnings)
    except StoreError as error:
        remedy = "; if the database then holds the run, this continues it: ".join(
            filter(None, [error.remedy, resume_command(run, store)])
        )
        raise BrokenRunError(run, error.reason, remedy=remedy) from error


@contextmanager
def concluding(run: str, store: Repository) -> Iterator[None]:
    """Let a signal or the keyboard stop what follows a run. UnconcludedError, with the next command, if it did."""
    try:
        with stoppable(within_s=_STOPS_WITHIN_S):
            yield
    except AbortedError as error:
        following = report_command(run, store) if store.analyses.load(run) else resume_command(run, store)
        raise UnconcludedError(run, following, error.by) from error


def _conclude(
    run: str,
    store: Repository,
    configuration: Configuration,
    plugins: Plugins,
    stages: Stages,
    warnings: Sequence[str],
) -> RunOutcome:
    with stages.stage("reading the run back"):
        record = store.runs.load_with_file_check(run)
    recipe, history, threads = configuration.recipe, store.changes.read_history(record), threading.enumerate()
    sensor_history = store.sensors.read_history(record.identity.sensor, record.identity.recipe, run)
    # Read before plugins, which may leave no file to open.
    failed_before = store.lists.read_failed_before(run) if sensor_history.failed_runs else ()
    conclusion = evaluate_run(record, recipe, plugins, stages, standards=configuration.station.standards)
    issued_at = RealClock().wall().isoformat()
    paused = _pause_notes(record)
    charts = charts_after(store, record.identity.station, record.identity, conclusion.measurements)
    calibration, calibration_why = calibrate_run(
        conclusion,
        recipe,
        calibration=store.new_id(),
        issued_at=issued_at,
        standards=configuration.station.standards,
    )
    if calibration is not None:
        calibration = _sign_with_key(calibration, configuration, store)
    result = fill_from_object(
        RunResult,
        conclusion,
        record=record,
        calibration=calibration,
        calibration_why=calibration_why,
        compute_s=stages.table(),
        warnings=(
            *conclusion.warnings,
            *warnings,
            *paused,
            *map(str, plugins.failures),
            *name_left_threads(threads),
            *(charts.warnings() if charts else ()),
            *warn_unexplained(history.changes_in(run)),
            *history.warnings,
            *record.chain.warnings,
            *sensor_history.warnings,
        ),
        limits_version=recipe.limits_version,
        station_check=store.stations.read_latest_check(record.identity.station, record.identity.started_at),
        station_charts=charts,
        history=history,
        sensor_history=sensor_history,
        coded=recipe.failure_codes,
        failed_before=failed_before,
    )
    store.analyses.save(result)
    resume = "" if record.end is EndReason.FINISHED else resume_command(run, store)
    return write_outputs(result, recipe, plugins, stages, configuration.seed, resume=resume)


def _sign_with_key(calibration: Calibration, configuration: Configuration, store: Repository) -> Calibration:
    """Sign a calibration with the station's key, if any. Raise BrokenRunError if the key cannot be used any more."""
    try:
        key = station_key(configuration.station)
    except RefusedError as error:
        remedy = f"{error.remedy}; then this computes the result: {resume_command(calibration.run, store)}"
        raise BrokenRunError(
            calibration.run, f"its calibration cannot be signed, and is not issued: {error.reason}", remedy=remedy
        ) from error
    return calibration if key is None else sign_calibration(calibration, key, RealClock().wall())


def _pause_notes(record: RunRecord) -> Iterator[str]:
    """Yield a note if pauses made rests before presses longer than the recipe says."""
    lasted_s = [pause.duration_s for pause in record.pauses if pause.duration_s is not None]
    if lasted_s:
        times = "once" if len(lasted_s) == 1 else f"{len(lasted_s)} times"
        yield (
            f"the run was paused {times}, for {duration(sum(lasted_s))} in all: before the next press"
            " the sheet rested longer than the recipe states"
        )


def warn_unexplained(changes: Iterable[ConfigurationChange]) -> tuple[str, ...]:
    """Return a warning for each change without a reason."""
    warnings = []
    for change in changes:
        if change.why == NO_REASON:
            earlier, began = change.earlier_run, time_of_id(change.earlier_run)
            run = f"run {earlier}" if began is None else f"the run of {write_local_time(began)} ({earlier})"
            warnings.append(
                f"{change.kind} {change.name!r} is not what {run} used: {change.words()};"
                f" {NO_REASON} (cbsr-qa run --why TEXT gives one)"
            )
    return tuple(warnings)
