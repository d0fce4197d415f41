"""Test one sensor: from files and a serial number to verdict, stored run, report and calibration file."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

from cbsr_qa.app.outputs import RunOutcome
from cbsr_qa.app.session import Session, check_configuration
from cbsr_qa.app.setup import configure
from cbsr_qa.app.software import software_versions
from cbsr_qa.app.stages import Stages
from cbsr_qa.clock import RealClock
from cbsr_qa.config.merge import Configuration
from cbsr_qa.config.paths import calibrations_folder, database_url, reports_folder, writable_folder
from cbsr_qa.config.serials import validate_batch, validate_operator, validate_reason, validate_serial
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.run import InstrumentIdentity, RunIdentity
from cbsr_qa.domain.sensor import SensorIdentity
from cbsr_qa.plugins import Plugins, discover
from cbsr_qa.runner.dry_run import DryRun
from cbsr_qa.store.repository import database_exists, open_store

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
    why: str = ""

    def checked(self) -> Self:
        """Return itself if serial, batch, operator and reason may be used; ConfigError otherwise."""
        validate_serial(self.serial)
        validate_batch(self.batch)
        validate_operator(self.operator)
        validate_reason(self.why)
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
    configuration, plugins = _checked(request.checked())
    with Session(configuration, plugins, Stages(), _nobody_in_a_dry_run) as session:
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
    configuration, plugins = _checked(request.checked())
    # Frames of a virtual clock can be made again after a power cut; those of a bench cannot.
    durable = configuration.station.clock == "real"
    with Session(configuration, plugins, Stages(tell), ask, why=request.why) as session:
        session.walk().refuse()
        for folder in (reports_folder(), calibrations_folder()):
            writable_folder(folder)
        with open_store(database_url(request.database), durable=durable) as store:
            run = store.new_id()
            identity = _identity(run, request, configuration, session.instruments(), plugins)
            with store.writing_alone(run, request.operator):
                return session.run(identity, store)


def _checked(request: RunRequest) -> tuple[Configuration, Plugins]:
    """Configuration and plugins of a run; what is wrong with the files is said before a database is looked at."""
    plugins = discover()
    check_configuration(request.configuration(0), plugins)
    return request.configuration(_seed(request)), plugins


def _seed(request: RunRequest) -> int:
    """Seed of a run, without making a database where there is none yet."""
    if request.seed is not None:
        return request.seed
    url = database_url(request.database)
    if not database_exists(url):
        return default_seed(request.serial, 0)
    with open_store(url, create=False) as store:
        return default_seed(request.serial, len(store.find_runs(request.serial)))


def _identity(
    run: str,
    request: RunRequest,
    configuration: Configuration,
    instruments: tuple[InstrumentIdentity, ...],
    plugins: Plugins,
) -> RunIdentity:
    return RunIdentity(
        run=run,
        sensor=SensorIdentity(request.serial, request.batch, configuration.sensor_type.name),
        station=configuration.station.name,
        recipe=configuration.recipe.name,
        operator=request.operator,
        started_at=RealClock().wall(),
        configuration_digest=configuration.digest,
        software=software_versions(plugins),
        instruments=instruments,
        simulated=tuple(f"{one.role}: {one.model}" for one in instruments if one.simulated),
    )
