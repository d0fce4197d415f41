"""Resume an interrupted run from the database."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Final

from cbsr_qa.app.command_hints import report_command
from cbsr_qa.app.gate.gate import ASKED_AGAIN, ask_gate, gate_refusal
from cbsr_qa.app.gate.request import GateRequest, Override
from cbsr_qa.app.run.conclusion import conclude_run
from cbsr_qa.app.run.console import NOBODY, RunConsole
from cbsr_qa.app.run.control import open_control
from cbsr_qa.app.run.outcome import RunOutcome
from cbsr_qa.app.run.preflight import check_configuration, check_recipe
from cbsr_qa.app.run.session import Done, Session, deliver_verdict
from cbsr_qa.app.run.stopping import stoppable_outside_steps
from cbsr_qa.config.loader import load_station
from cbsr_qa.config.merging import Configuration, restore
from cbsr_qa.config.paths import calibrations_folder, database_url, reports_folder, writable_folder
from cbsr_qa.config.serials import validate_operator
from cbsr_qa.domain.errors import AT_COMMAND_LINE, CbsrError, ConfigError, PluginError, StoreError
from cbsr_qa.domain.plan.steps import Press
from cbsr_qa.domain.run.run import InstrumentIdentity, RunIdentity
from cbsr_qa.domain.run.states import ResultState
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.software import NOT_INSTALLED, software_versions
from cbsr_qa.station.plan import describe, schedule
from cbsr_qa.station.setup import plan_of
from cbsr_qa.store.damage import name_database
from cbsr_qa.store.engine import parse_url
from cbsr_qa.store.opening import open_existing, open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.clock import RealClock, Stages

_ELSEWHERE: Final = (
    "a run that was begun with another database is resumed with that one\n"
    f"{AT_COMMAND_LINE}--database; cbsr-qa db status lists the runs that can be resumed"
)


def resume_run(
    run: str,
    console: RunConsole = NOBODY,
    *,
    database: str | None = None,
    operator: str = "",
    station: str | None = None,
    override: Override | None = None,
) -> RunOutcome:
    """Resume a run at its next unfinished load, after homing and finding surfaces again.

    Station, recipe, sensor type, material and seed are the original ones. If only the result is missing, nothing
    moves.

    Parameters
    ----------
    station : file of the run's station as it is now, for the gate alone: who may work at it, its policies, and the
        calibration dates of its instruments. None for what is stored with the run, which has no list of operators.
    override : override of the gate's refusals.

    Raises
    ------
    RefusedError
        Before anything moves: the run is unknown, damaged, finished, being written by another process, signed with
        a key that is not set, its configuration or plugins no longer pass the checks, or the gate refuses it.
    InstrumentError
        If an instrument does not answer.
    """
    console.begin(run)
    validate_operator(operator)
    override = (override or Override()).validate()
    url = database_url(database)
    if (existing := open_existing(url)) is None:
        raise StoreError(f"{name_database(parse_url(url))} does not exist or is empty", remedy=_ELSEWHERE)
    with existing as store:
        on_real_clock = restore(_configuration(store, run)).station.clock == "real"
    folders = reports_folder(), calibrations_folder()
    for folder in folders:
        writable_folder(folder)
    with ExitStack() as stack:
        store = stack.enter_context(open_store(url, create=False, durable=on_real_clock))
        stack.enter_context(store.claims.hold_run(run, operator))
        stored = store.runs.read_identity(run)
        stack.enter_context(store.claims.claim_sensor(stored.sensor.serial, stored.recipe, operator))
        to_gate = GateRequest(
            serial=stored.sensor.serial,
            batch=stored.sensor.batch,
            operator=operator,
            database=url,
            folders=folders,
            override=override,
            resumed=True,
            pin=console.read_pin,
        )
        return _continue_run(store, stored, to_gate, station, console)


def _configuration(store: Repository, run: str) -> str:
    """Return the configuration of a run. Raise StoreError if it is unknown or damaged."""
    try:
        return store.runs.read_configuration(run)
    except StoreError as error:
        raise StoreError(
            f"{error.reason} ({store.shown})",
            remedy=error.remedy or _ELSEWHERE,
        ) from error


def _continue_run(
    store: Repository, stored: RunIdentity, to_gate: GateRequest, station: str | None, console: RunConsole
) -> RunOutcome:
    run, plugins = stored.run, discover()
    store.runs.check_resumable(run)
    configuration = restore(store.runs.read_configuration(run))
    now = RealClock().wall()
    identity = replace(stored, operator=to_gate.operator, software=software_versions(plugins), started_at=now)
    software_changes = compare_software(stored, identity)
    result = store.runs.read_result_state(run)
    if result is ResultState.STORED:
        raise StoreError(
            f"run {run} is finished, and has its result",
            remedy=f"{report_command(run, store)} writes its report and calibration file again",
        )
    if result is ResultState.MISSING:
        with name_removed_plugins(stored, identity):
            check_recipe(configuration.recipe, configuration.sensor_type, plugins)  # nothing moves: no other check
        outcome = conclude_run(run, store, configuration, plugins, Stages(console.tell), software_changes)
        deliver_verdict(outcome, identity, configuration, plugins)
        return outcome
    with name_removed_plugins(stored, identity):
        check_configuration(configuration, plugins)
    done_before = Done(
        store.runs.list_finished_loads(run),
        store.runs.list_ended_phases(run),
        store.runs.find_resume_time_s(run),
        store.runs.count_prompts(run),
        store.runs.load(run) if plan_of(configuration, plugins).decides else None,
    )
    with (
        name_removed_plugins(stored, identity),
        stoppable_outside_steps(),
        open_control(configuration, to_gate, console, run) as control,
    ):
        gate = ask_gate(to_gate, _as_it_is_now(configuration, station), plugins, store, ASKED_AGAIN)
        if (refused := gate_refusal(gate)) is not None:
            raise refused
        with Session(configuration, plugins, control, done=done_before, gate=gate) as session:
            session.walk().refuse()
            session.warnings += [*software_changes, *compare_instruments(stored, session.instruments())]
            session.press(identity, store)
            return session.conclude(identity, store)


def _as_it_is_now(configuration: Configuration, station: str | None) -> Configuration:
    """Return the configuration with the station's present file, for the gate. ConfigError for another station."""
    if station is None:
        return configuration
    current = load_station(station).value
    if current.name != configuration.station.name:
        raise ConfigError(
            f"the run was begun on station {configuration.station.name!r}, and the file given is of {current.name!r}",
            remedy=f"resume it on its own station\n{AT_COMMAND_LINE}give that station's file, or leave --station out",
        )
    return replace(configuration, station=current)


def compare_software(stored: RunIdentity, now: RunIdentity) -> list[str]:
    """Return a warning if software versions differ from those at the start of the run."""
    stored_versions, current_versions = dict(stored.software), dict(now.software)
    differing = ", ".join(
        f"{name} {stored_versions.get(name, NOT_INSTALLED)} → {current_versions.get(name, NOT_INSTALLED)}"
        for name in dict.fromkeys([*stored_versions, *current_versions])
        if stored_versions.get(name) != current_versions.get(name)
    )
    return [f"the run was begun with other software than it went on with: {differing}"] if differing else []


@contextmanager
def name_removed_plugins(stored: RunIdentity, now: RunIdentity) -> Iterator[None]:
    """Say which packages of plugins a run began with are missing now, where its plugins are refused.

    Raises
    ------
    PluginError, ConfigError
        The same, with the packages and their versions, if one is missing.
    """
    try:
        yield
    except (PluginError, ConfigError) as error:
        current_versions = dict(now.software)
        removed = [
            (name, version)
            for name, version in stored.software
            if version != NOT_INSTALLED and current_versions.get(name, NOT_INSTALLED) == NOT_INSTALLED
        ]
        if not removed:
            raise
        removed_words = ", ".join(f"{name} {version}" for name, version in removed)
        pinned = " ".join(f"{name}=={version}" for name, version in removed)
        raise type(error)(
            f"{error.reason}; the run was begun with {removed_words}, which is not installed now",
            remedy=f"install it again, then resume the run\n{AT_COMMAND_LINE}pip install {pinned}",
        ) from error


def compare_instruments(stored: RunIdentity, instruments: tuple[InstrumentIdentity, ...]) -> list[str]:
    """Return a warning for each instrument that differs from the one at the start of the run."""
    stored_by_role = {instrument.role: _describe_instrument(instrument) for instrument in stored.instruments}
    return [
        f"{role} is another instrument than the run was begun with: {stored_by_role.get(role, 'none')} → {current}"
        for role, current in ((instrument.role, _describe_instrument(instrument)) for instrument in instruments)
        if stored_by_role.get(role) != current
    ]


def _describe_instrument(instrument: InstrumentIdentity) -> str:
    return " ".join(filter(None, [instrument.model, instrument.serial, instrument.firmware]))


def find_next_step(store: Repository, run: str, plugins: Plugins) -> tuple[str, str] | None:
    """Return the phase in which a resumed run would continue, and its next step in words.

    Return None if its configuration or one of its plugins can no longer be used.
    """
    try:
        plan, ended = plan_of(restore(store.runs.read_configuration(run)), plugins), store.runs.list_ended_phases(run)
        remaining_phases = [
            phase for phase in schedule(plan, store.runs.list_finished_loads(run), ended) if phase.index not in ended
        ]
    except CbsrError:
        return None
    if not remaining_phases:
        return "", "its end"
    presses = [step for step in remaining_phases[0].steps if isinstance(step.step, Press)]
    return remaining_phases[0].name, describe(presses[0].step) if presses else "the end of the phase"
