"""Test one sensor: from files and a serial number to verdict, stored run, report and calibration file."""

import hashlib
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from cbsr_qa.app.conclude import calibrated, conclude
from cbsr_qa.app.outputs import RunOutcome, write_outputs
from cbsr_qa.app.preflight import check_cycles, check_recipe, check_unloaded, overdue, refuse_overdue
from cbsr_qa.app.setup import configure, open_station, plan_of, station_clock
from cbsr_qa.app.software import software_versions
from cbsr_qa.app.stages import Stages
from cbsr_qa.clock import RealClock
from cbsr_qa.config.merge import Configuration
from cbsr_qa.config.paths import calibrations_folder, database_url, reports_folder, writable_folder
from cbsr_qa.config.serials import validate_batch, validate_operator, validate_serial
from cbsr_qa.domain.errors import BrokenRunError, RefusedError, StoreError
from cbsr_qa.domain.report import RunResult
from cbsr_qa.domain.run import RunIdentity
from cbsr_qa.domain.run_events import PhaseFinished, PhaseStarted, RunEvent, RunStarted
from cbsr_qa.domain.sensor import SensorIdentity
from cbsr_qa.plugins import Plugins, discover
from cbsr_qa.runner.asking import Asking
from cbsr_qa.runner.dry_run import DryRun, dry_run
from cbsr_qa.runner.execute import execute
from cbsr_qa.runner.progress import RunProgress
from cbsr_qa.store.repository import Repository, database_exists, open_store

#: Seeds are kept to what every tool that reads a run can hold as an integer.
_SEED_BITS = 31


@dataclass(frozen=True, slots=True)
class RunRequest:
    """What a user asks for; see the options of ``cbsr-qa run``."""

    station: str
    recipe: str
    serial: str
    batch: str = ""
    operator: str = ""
    sensor_type: str | None = None
    material: str | None = None
    seed: int | None = None
    database: str | None = None

    def checked(self) -> Self:
        """Return itself if serial, batch and operator may be used; ConfigError otherwise."""
        validate_serial(self.serial)
        validate_batch(self.batch)
        validate_operator(self.operator)
        return self

    def configuration(self, seed: int) -> Configuration:
        """Load and merge the files; ConfigError where one is missing or wrong."""
        return configure(self.station, self.recipe, sensor_type=self.sensor_type, material=self.material, seed=seed)


def default_seed(serial: str, earlier_runs: int) -> int:
    """Seed of a run nobody gave one: the same for the same try of the same sensor, another for the next try."""
    digest = hashlib.sha256(f"{serial}/{earlier_runs}".encode()).digest()
    return int.from_bytes(digest[:4]) >> (32 - _SEED_BITS)


def plan_run(request: RunRequest) -> DryRun:
    """Walk a run without moving or writing anything.

    Raises
    ------
    RefusedError
        As :func:`run_sensor`, before anything moves; broken limits are listed in the result instead.
    """
    with _Session(request.checked(), discover(), Stages(), _nobody_in_a_dry_run) as session:
        return session.walk()


def _nobody_in_a_dry_run(text: str) -> str:
    raise RefusedError(f"a dry run asks nobody, and was to ask: {text}")


def run_sensor(
    request: RunRequest,
    *,
    tell: Callable[[str], None] = lambda stage: None,
    ask: Callable[[str], str] | None = None,
) -> RunOutcome:
    """Test one sensor.

    Parameters
    ----------
    tell : told what the computer is busy with.
    ask : shows a text to the operator and returns the answer; None where nobody is there: then a recipe with prompts,
        and a station with instruments that are worked by hand, are refused.

    Returns
    -------
    What came of it, whatever it was: a run that was aborted or broken is an outcome, stored and reported.

    Raises
    ------
    RefusedError
        Before anything moves and with nothing written: a file, a name, a plugin or a limit is wrong.
    InstrumentError
        If an instrument does not answer at the start.
    """
    with _Session(request.checked(), discover(), Stages(tell), ask) as session:
        session.walk().refuse()
        for folder in (reports_folder(), calibrations_folder()):
            writable_folder(folder)
        with open_store(database_url(request.database), durable=session.on_real_clock) as store:
            return session.run(store)


def _seed(request: RunRequest) -> int:
    """Seed of a run, without making a database where there is none yet."""
    if request.seed is not None:
        return request.seed
    url = database_url(request.database)
    if not database_exists(url):
        return default_seed(request.serial, 0)
    with open_store(url, create=False) as store:
        return default_seed(request.serial, len(store.find_runs(request.serial)))


class _Session:
    """One run with everything it needs at hand: files checked, plugins found, the bench open."""

    def __init__(
        self, request: RunRequest, plugins: Plugins, stages: Stages, ask: Callable[[str], str] | None
    ) -> None:
        self._request = request
        self._asks = ask
        self._progress: RunProgress | None = None
        self._plugins = plugins
        self._stages = stages
        self._warnings: list[str] = []
        # Once without a seed: what is wrong with the files is said before a database is looked at.
        first_look = request.configuration(0)
        refuse_overdue(first_look.station, RealClock().wall().date())
        check_recipe(first_look.recipe, first_look.sensor_type, plugins)
        planned = plan_of(first_look, plugins)
        check_unloaded(planned, first_look.recipe)
        check_cycles(planned, first_look.recipe)
        self._configuration = request.configuration(_seed(request))
        self._plan = plan_of(self._configuration, plugins)
        self._clock = station_clock(self._configuration)
        self._ask = None if ask is None else Asking(self._asked)
        self._bench = open_station(self._configuration, plugins, self._clock, ask=self._ask)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bench.close()

    @property
    def on_real_clock(self) -> bool:
        """Whether the frames cost real time: those of a virtual clock can be made again after a power cut."""
        return self._configuration.station.clock == "real"

    def walk(self) -> DryRun:
        """Count what the recipe asks for, and what the station would not allow."""
        return dry_run(self._plan, self._bench.frame_source.frame_period_s, answered=self._ask is not None)

    def _asked(self, text: str) -> str:
        """Ask the operator; what shows progress on the terminal makes room meanwhile."""
        assert self._asks is not None
        with nullcontext() if self._progress is None else self._progress.paused():
            return self._asks(text)

    def run(self, store: Repository) -> RunOutcome:
        """Drive the bench, then work out from the store what it came to.

        Raises
        ------
        BrokenRunError
            If that could not be stored or read back (a full disk): what was stored of the run stays.
        """
        identity = self._identity(store.new_id())
        self._warnings += overdue(identity.instruments, identity.started_at.date())
        with self._stages.stage("running the station"):
            self._drive(identity, store)
        try:
            return self._conclude(identity.run, store)
        except StoreError as error:
            raise BrokenRunError(identity.run, error.reason, remedy=error.remedy) from error

    def _drive(self, identity: RunIdentity, store: Repository) -> None:
        configuration = self._configuration
        journal = store.journal(
            configuration=configuration.canonical,
            sensor_type=configuration.sensor_type,
            material=configuration.material,
            indenter=configuration.station.indenter,
        )
        with RunProgress(len(self._plan.phases), self._clock) as progress:
            self._progress = progress
            execute(
                self._plan,
                identity,
                self._bench,
                self._clock,
                [journal, progress, self._hooks(identity)],
                ask=self._ask,
                warn=self._warnings.append,
            )

    def _hooks(self, identity: RunIdentity) -> Callable[[RunEvent], None]:
        """Tell plugins what happens; one that fails becomes a warning of the run."""
        tell, warn = self._plugins.tell, self._warnings.append
        names: dict[int, str] = {}

        def plugin_hooks(event: RunEvent) -> None:
            match event:
                case RunStarted():
                    tell("cbsr_run_started", warn, may_abort=True, identity=identity)
                case PhaseStarted():
                    names[event.index] = event.name
                case PhaseFinished():
                    tell("cbsr_phase_finished", warn, may_abort=True, identity=identity, phase=names[event.index])

        return plugin_hooks

    def _conclude(self, run: str, store: Repository) -> RunOutcome:
        with self._stages.stage("reading the run back"):
            record = store.load_run(run)
        recipe = self._configuration.recipe
        conclusion = conclude(record, recipe, self._plugins, self._stages)
        issued_at = RealClock().wall().isoformat()
        calibration, why = calibrated(conclusion, recipe, calibration=store.new_id(), issued_at=issued_at)
        result = RunResult(
            record=record,
            observation=conclusion.observation,
            measurements=conclusion.measurements,
            verdict=conclusion.verdict,
            calibration=calibration,
            calibration_why=why,
            compute_s=self._stages.table(),
            warnings=(*conclusion.warnings, *self._warnings),
            limits_version=recipe.limits_version,
            characterisation=conclusion.characterisation,
            station_check=store.latest_station_check(record.identity.station, record.identity.started_at),
        )
        store.save_result(result)
        return write_outputs(result, recipe, self._plugins, self._stages, self._plan.seed)

    def _identity(self, run: str) -> RunIdentity:
        configuration, request = self._configuration, self._request
        instruments = self._bench.identities()
        return RunIdentity(
            run=run,
            sensor=SensorIdentity(request.serial, request.batch, configuration.sensor_type.name),
            station=configuration.station.name,
            recipe=configuration.recipe.name,
            operator=request.operator,
            started_at=RealClock().wall(),
            configuration_digest=configuration.digest,
            software=software_versions(self._plugins),
            instruments=instruments,
            simulated=tuple(f"{one.role}: {one.model}" for one in instruments if one.simulated),
        )
