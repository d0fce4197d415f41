"""Test one sensor: check, gate, open, press, conclude. From a request to verdict, report and calibration file."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace

from cbsr_qa.app.gate.gate import ask_before, ask_gate_again, gate_refusal
from cbsr_qa.app.gate.request import GateRequest
from cbsr_qa.app.run.console import NOBODY, RunConsole
from cbsr_qa.app.run.control import Control, open_control
from cbsr_qa.app.run.outcome import RunOutcome
from cbsr_qa.app.run.request import RunRequest, check_request, check_unchanged, free_seeds
from cbsr_qa.app.run.session import Session
from cbsr_qa.app.run.stopping import stoppable_outside_steps
from cbsr_qa.config.paths import writable_folder
from cbsr_qa.domain.plan.gate import GateCheck
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.plugin.software import software_versions
from cbsr_qa.station.interrupts import on_stderr
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.clock import RealClock


def run_sensor(request: RunRequest, console: RunConsole = NOBODY) -> RunOutcome:
    """Test one sensor. Meanwhile nobody else uses the station, and its control channel is served.

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
    plugins, checked, to_gate = check_request(request)
    with stoppable_outside_steps(), open_control(checked, to_gate, console) as control:
        gate = ask_before(replace(to_gate, pin=console.read_pin), checked, plugins)
        if (refused := gate_refusal(gate)) is not None:
            raise refused
        seeds = free_seeds(request.serial, to_gate.database)
        while True:
            configuration = request.configuration(next(seeds) if request.seed is None else request.seed)
            check_unchanged(configuration, checked)
            with Session(configuration, plugins, control, why=request.why, gate=gate) as session:
                session.walk().refuse()
                with _begin_run(session, to_gate, control, takes_seed=request.seed is None) as begun:
                    if begun is not None:
                        session.press(*begun)
                        return session.conclude(*begun)
            control.tell("another run of this sensor has begun meanwhile: opening the bench again with the next seed")


@contextmanager
def _begin_run(
    session: Session, asked: GateRequest, control: Control, *, takes_seed: bool
) -> Iterator[tuple[RunIdentity, Repository] | None]:
    """Open the database and begin a run of an open session in it; while entered, no other run of the sensor begins.

    Yield None, with nothing moved, if another run of the sensor has its seed.

    Parameters
    ----------
    takes_seed : whether the seed is the next of the sensor, which no other run may have.

    Raises
    ------
    RefusedError
        If another run of the sensor began or ended since the gate was asked, so that it now refuses a retest.
    """
    configuration, serial, operator = session.configuration, asked.serial, asked.operator
    for folder in asked.folders:
        writable_folder(folder)
    # Frames of a virtual clock can be simulated again after a power cut; those of a bench are lost.
    durable = configuration.station.clock == "real"
    with open_store(asked.database, durable=durable, tell=on_stderr) as store, ExitStack() as claims:
        if takes_seed and not claims.enter_context(store.sensors.claim_seed(serial, configuration.seed, operator)):
            yield None
            return
        identity = _identity(store.new_id(), asked, session)
        tested_by = claims.enter_context(store.claims.claim_sensor(serial, identity.recipe, operator))
        # No other run of the sensor can begin now, and one that has ended is stored.
        asked = replace(asked, tested_by=tested_by)
        session.gate = ask_gate_again(session.gate, [GateCheck.RETEST], asked, configuration, session.plugins, store)
        control.begin(identity.run)
        claims.enter_context(store.claims.hold_run(identity.run, operator))
        yield identity, store


def _identity(run: str, asked: GateRequest, session: Session) -> RunIdentity:
    configuration, instruments = session.configuration, session.instruments()
    return RunIdentity(
        run=run,
        sensor=SensorIdentity(asked.serial, asked.batch, configuration.sensor_type.name),
        station=configuration.station.name,
        recipe=configuration.recipe.name,
        operator=asked.operator,
        started_at=RealClock().wall(),
        configuration_digest=configuration.digest,
        software=software_versions(session.plugins),
        instruments=instruments,
        simulated=tuple(
            f"{instrument.role}: {instrument.model}" for instrument in instruments if instrument.simulated
        ),
        parts=asked.parts,
    )
