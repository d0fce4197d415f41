"""Test one sensor: from files and a serial number to verdict, stored run, report and calibration file."""

import hashlib
from collections.abc import Callable, Collection
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Self

from cbsr_qa.app.gate.gate import ask_before, ask_gate_again, gate_refusal
from cbsr_qa.app.gate.people import asks_pin
from cbsr_qa.app.gate.request import GateRequest, Override
from cbsr_qa.app.gate.shown import GateShown, gate_outcome
from cbsr_qa.app.run.control import Control, open_control
from cbsr_qa.app.run.outcome import RunOutcome
from cbsr_qa.app.run.planned import PlannedRun
from cbsr_qa.app.run.session import Session, check_configuration
from cbsr_qa.app.run.stopping import stoppable_outside_steps
from cbsr_qa.config.merging import Configuration, list_files
from cbsr_qa.config.paths import calibrations_folder, check_folder, database_url, reports_folder, writable_folder
from cbsr_qa.config.serials import validate_batch, validate_operator, validate_reason, validate_serial
from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.gate import GateCheck
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.run.changes import SensorHistory
from cbsr_qa.domain.run.gate import GateAnswer
from cbsr_qa.domain.run.run import InstrumentIdentity, RunIdentity
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.software import software_versions
from cbsr_qa.station.control.lock import refuse_busy
from cbsr_qa.station.interrupts import on_stderr
from cbsr_qa.station.setup import configure
from cbsr_qa.store.engine import parse_url, sqlite_file
from cbsr_qa.store.opening import check_usable, open_existing, open_store
from cbsr_qa.system.clock import RealClock, Stages

#: Seeds are limited to integers that every tool can represent.
_SEED_BITS = 31


@dataclass(frozen=True, slots=True)
class RunRequest:
    """A run to make; see the options of ``cbsr-qa run``.

    Parameters
    ----------
    override : override of the gate's refusals.
    golden : whether it measures the golden sensor of a station check.
    """

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
    override: Override = field(default_factory=Override)
    golden: bool = False

    def validate(self) -> Self:
        """Return itself. Raise ConfigError if serial, batch, operator, reason or override is not allowed."""
        validate_serial(self.serial)
        validate_batch(self.batch)
        validate_operator(self.operator)
        validate_reason(self.why)
        self.override.validate()
        return self

    def configuration(self, seed: int, plugins: Plugins | None = None) -> Configuration:
        """Load and merge the files. Raise ConfigError if one is missing or wrong."""
        return configure(
            self.station,
            self.recipe,
            sensor_type=self.sensor_type,
            material=self.material,
            seed=seed,
            plugins=plugins,
        )


def default_seed(serial: str, earlier_runs: int) -> int:
    """Return the default seed, which depends on sensor and number of the try."""
    digest = hashlib.sha256(f"{serial}/{earlier_runs}".encode()).digest()
    return int.from_bytes(digest[:4]) >> (32 - _SEED_BITS)


def plan_run(request: RunRequest, *, attended: bool = False) -> PlannedRun:
    """Plan a run with all its checks, without moving or writing anything.

    Parameters
    ----------
    attended : whether an operator could answer prompts; none is shown.

    Raises
    ------
    RefusedError
        For the reasons of :func:`run_sensor`, except violated limits of the station: the result lists those.
    """
    plugins, _ = _check_request(request.validate())
    configuration = request.configuration(_seed(request))
    refuse_busy(configuration.station.name)
    answers = _gate(request, configuration, plugins, preview=True)
    ask = _nobody_in_a_dry_run if attended else None
    with stoppable_outside_steps(), Session(configuration, plugins, Stages(), ask) as session:
        return PlannedRun.from_dry_run(session.walk(), _history(request, configuration), plugins.failures, answers)


def preview_gate(request: RunRequest, pin: Callable[[str], str] | None = None) -> CommandOutcome[GateShown]:
    """Ask the gate about a run without making it; no instrument is opened, nothing written.

    Parameters
    ----------
    pin : PIN as for :func:`run_sensor`; without it no PIN is asked for.

    Raises
    ------
    RefusedError
        For the reasons of :func:`run_sensor`, except refusals of the gate: the result lists those.
    """
    plugins, _ = _check_request(request.validate())
    configuration = request.configuration(0)
    answers = _gate(request, configuration, plugins, pin=pin, preview=pin is None)
    station = configuration.station
    return gate_outcome(
        request.serial,
        station.name,
        configuration.recipe.name,
        answers,
        asks_pin=asks_pin(station.gate, request.operator),
    )


def _nobody_in_a_dry_run(text: str) -> str:
    raise RefusedError(f"a dry run cannot ask the operator; the question was: {text}")


def run_sensor(
    request: RunRequest,
    *,
    tell: Callable[[str], None] = lambda stage: None,
    ask: Callable[[str], str] | None = None,
    begun: Callable[[str], None] = lambda run: None,
    answers: bool = False,
    pin: Callable[[str], str] | None = None,
    show: Callable[[str], None] | None = None,
) -> RunOutcome:
    """Test one sensor. Meanwhile nobody else uses the station, and its control channel is served.

    Parameters
    ----------
    tell : called with the current activity.
    ask : shows a text to the operator and returns the answer; None without an operator: prompts and instruments
        worked by hand are then refused.
    begun : called with the run's identifier before anything is stored.
    answers : whether prompts are answered over the control channel, instead of with ``ask``.
    pin : shows a text and returns the PIN of the operator; called only if the station file has one.
    show : called with lines on what the station does; None shows them on stderr.

    Returns
    -------
    The outcome, also of a run that was aborted or broken; it is stored and reported.

    Raises
    ------
    RefusedError
        Before anything moves and with nothing written: a file, a name, a plugin or a limit is wrong, another
        process uses the station, or its gate refuses the run.
    InstrumentError
        If an instrument does not answer at the start.
    StoppedError
        If a signal stopped it before the first step; the bench is safe and closed.
    """
    plugins, configuration = _check_request(request.validate())
    sensor_and_operator = {"serial": request.serial, "batch": request.batch, "operator": request.operator}
    with stoppable_outside_steps(), open_control(configuration, **sensor_and_operator, answers=answers) as control:
        gate = _gate(request, configuration, plugins, pin=pin)
        if (refused := gate_refusal(gate)) is not None:
            raise refused
        return _test_sensor(request, plugins, configuration, gate, control, control.telling(tell), ask, begun, show)


def _test_sensor(
    request: RunRequest,
    plugins: Plugins,
    gated: Configuration,
    gate: tuple[GateAnswer, ...],
    control: Control,
    tell: Callable[[str], None],
    ask: Callable[[str], str] | None,
    begun: Callable[[str], None],
    show: Callable[[str], None] | None,
) -> RunOutcome:
    seeds_taken: list[int] = []
    while True:
        configuration = request.configuration(_seed(request, seeds_taken))
        if list_files(configuration) != list_files(gated):
            raise ConfigError(
                "the files of this run were changed while the gate was asked",
                remedy="start the run again: the gate answers for the files as they are then",
            )
        with Session(
            configuration, plugins, Stages(tell), ask, why=request.why, control=control, show=show
        ) as session:
            session.walk().refuse()
            outcome = _run_and_store(request, configuration, plugins, session, gate, control.begins(begun))
        if outcome is not None:
            return outcome
        seeds_taken.append(configuration.seed)
        tell("another run of this sensor has begun meanwhile: opening the bench again with the next seed")


def _run_and_store(
    request: RunRequest,
    configuration: Configuration,
    plugins: Plugins,
    session: Session,
    gate: tuple[GateAnswer, ...],
    begun: Callable[[str], None],
) -> RunOutcome | None:
    """Run a checked session; None, with nothing moved, if another run of the sensor has its seed.

    Raise RefusedError if another run of the sensor began or ended since the gate was asked, so that the gate now
    refuses a retest.
    """
    for folder in _folders():
        writable_folder(folder)
    # Frames of a virtual clock can be simulated again after a power cut; those of a bench are lost.
    durable = configuration.station.clock == "real"
    with open_store(database_url(request.database), durable=durable, tell=on_stderr) as store, ExitStack() as stack:
        run = store.new_id()
        identity = _identity(run, request, configuration, session.instruments(), plugins)
        if request.seed is None:
            claim = store.sensors.claim_seed(request.serial, configuration.seed, request.operator)
            if not stack.enter_context(claim):
                return None
        tested_by = stack.enter_context(store.claims.claim_sensor(request.serial, identity.recipe, request.operator))
        # No other run of the sensor can begin now, and one that has ended is stored.
        gate_request = _gate_request(request, tested_by=tested_by)
        session.gate = ask_gate_again(gate, [GateCheck.RETEST], gate_request, configuration, plugins, store)
        begun(run)
        stack.enter_context(store.claims.hold_run(run, request.operator))
        return session.run(identity, store)


def _folders() -> tuple[Path, ...]:
    return reports_folder(), calibrations_folder()


def _check_request(request: RunRequest) -> tuple[Plugins, Configuration]:
    """Check files, then folders and database, before the bench is opened; the configuration is that of seed 0."""
    plugins = discover()
    configuration = request.configuration(0, plugins)
    check_configuration(configuration, plugins)
    url = database_url(request.database)
    file = sqlite_file(parse_url(url))
    for folder in (*_folders(), *(() if file is None else (file.parent,))):
        check_folder(folder)
    check_usable(url)
    return plugins, configuration


def _gate(
    request: RunRequest,
    configuration: Configuration,
    plugins: Plugins,
    *,
    pin: Callable[[str], str] | None = None,
    preview: bool = False,
) -> tuple[GateAnswer, ...]:
    return ask_before(_gate_request(request, pin=pin, preview=preview), configuration, plugins)


def _gate_request(
    request: RunRequest, *, pin: Callable[[str], str] | None = None, preview: bool = False, tested_by: str = ""
) -> GateRequest:
    return fill_from_object(
        GateRequest,
        request,
        database=database_url(request.database),
        folders=_folders(),
        pin=pin,
        preview=preview,
        resumed=False,
        tested_by=tested_by,
    )


def _seed(request: RunRequest, taken: Collection[int] = ()) -> int:
    """Return the given seed, or the first default one that no run of the sensor has; creates no database."""
    if request.seed is not None:
        return request.seed
    with open_existing(database_url(request.database)) or nullcontext() as store:
        stored = () if store is None else store.sensors.list_seeds(request.serial)
    seeds = (default_seed(request.serial, number) for number in count(len(stored)))
    return next(seed for seed in seeds if seed not in stored and seed not in taken)


def _history(request: RunRequest, configuration: Configuration) -> SensorHistory:
    sensor = SensorIdentity(request.serial, request.batch, configuration.sensor_type.name)
    with open_existing(database_url(request.database)) or nullcontext() as store:
        recipe = configuration.recipe.name
        return SensorHistory(sensor, recipe) if store is None else store.sensors.read_history(sensor, recipe)


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
        simulated=tuple(
            f"{instrument.role}: {instrument.model}" for instrument in instruments if instrument.simulated
        ),
    )
