"""What follows a run: it is read back, evaluated and stored; report and calibration file are written."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from cbsr_qa.analysis import calibrated, evaluate_run
from cbsr_qa.app.changes import unexplained
from cbsr_qa.app.command_hints import report_command, resume_command
from cbsr_qa.app.run.outcome import RunOutcome
from cbsr_qa.app.run.outputs import write_outputs
from cbsr_qa.app.run.preflight import station_key
from cbsr_qa.app.run.stopping import stoppable
from cbsr_qa.calibration.file import sign_calibration
from cbsr_qa.config import Configuration
from cbsr_qa.domain import AbortedError, BrokenRunError, RefusedError, StoreError, UnconcludedError, filled
from cbsr_qa.domain.results import Calibration, EndReason, RunResult
from cbsr_qa.domain.run import RunRecord
from cbsr_qa.plugin import Plugins, left_running
from cbsr_qa.report import duration
from cbsr_qa.store import Repository
from cbsr_qa.studies.charts import charts_after
from cbsr_qa.system import RealClock, Stages

#: How long what computes a result may take to stop; beyond numerical libraries, which hear nothing in a call [s].
_STOPS_WITHIN_S: Final = 30.0


def concluded(
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
            return _concluded(run, store, configuration, plugins, stages, warnings)
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
        following = report_command(run, store) if store.analyses(run) else resume_command(run, store)
        raise UnconcludedError(run, following, error.by) from error


def _concluded(
    run: str,
    store: Repository,
    configuration: Configuration,
    plugins: Plugins,
    stages: Stages,
    warnings: Sequence[str],
) -> RunOutcome:
    with stages.stage("reading the run back"):
        record = store.whole_run(run)
    recipe, history, threads = configuration.recipe, store.change_history(record), threading.enumerate()
    earlier = store.sensor_history(record.identity.sensor, record.identity.recipe, run)
    conclusion = evaluate_run(record, recipe, plugins, stages)
    issued_at = RealClock().wall().isoformat()
    paused = _paused(record)
    charts = charts_after(store, record.identity.station, record.identity, conclusion.measurements)
    calibration, why = calibrated(conclusion, recipe, calibration=store.new_id(), issued_at=issued_at)
    if calibration is not None:
        calibration = _signed(calibration, configuration, store)
    result = filled(
        RunResult,
        conclusion,
        record=record,
        calibration=calibration,
        calibration_why=why,
        compute_s=stages.table(),
        warnings=(
            *conclusion.warnings,
            *warnings,
            *paused,
            *map(str, plugins.failures),
            *left_running(threads),
            *(charts.warnings() if charts else ()),
            *unexplained(history.of(run)),
            *history.warnings,
            *record.chain.warnings,
            *earlier.warnings,
        ),
        limits_version=recipe.limits_version,
        station_check=store.latest_station_check(record.identity.station, record.identity.started_at),
        station_charts=charts,
        history=history,
        sensor_history=earlier,
    )
    store.save_result(result)
    resume = "" if record.end is EndReason.FINISHED else resume_command(run, store)
    return write_outputs(result, recipe, plugins, stages, configuration.seed, resume=resume)


def _signed(calibration: Calibration, configuration: Configuration, store: Repository) -> Calibration:
    """Sign a calibration with the station's key, if it has one. BrokenRunError if the key cannot be used any more."""
    try:
        key = station_key(configuration.station)
    except RefusedError as error:
        again = f"{error.remedy}; then this computes the result: {resume_command(calibration.run, store)}"
        raise BrokenRunError(
            calibration.run, f"its calibration cannot be signed, and is not issued: {error.reason}", remedy=again
        ) from error
    return calibration if key is None else sign_calibration(calibration, key, RealClock().wall())


def _paused(record: RunRecord) -> Iterator[str]:
    """Yield a note if pauses made rests before presses longer than the recipe says."""
    lasted_s = [pause.duration_s for pause in record.pauses if pause.duration_s is not None]
    if lasted_s:
        times = "once" if len(lasted_s) == 1 else f"{len(lasted_s)} times"
        yield (
            f"the run was paused {times}, for {duration(sum(lasted_s))} in all: before the next press"
            " the sheet rested longer than the recipe states"
        )
