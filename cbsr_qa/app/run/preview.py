"""What a run would do, and whether it may begin: nothing moves, and nothing is written."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace

from cbsr_qa.app.gate.gate import ask_before
from cbsr_qa.app.gate.people import asks_pin
from cbsr_qa.app.gate.shown import GateShown, gate_outcome
from cbsr_qa.app.run.console import Unattended
from cbsr_qa.app.run.control import Control
from cbsr_qa.app.run.planned import PlannedRun
from cbsr_qa.app.run.request import RunRequest, check_request, free_seeds
from cbsr_qa.app.run.session import Session
from cbsr_qa.app.run.stopping import stoppable_outside_steps
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.run.changes import SensorHistory
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.station.control.lock import refuse_busy
from cbsr_qa.store.opening import open_existing


class _OfDryRun(Unattended):
    """An operator who could answer prompts, if ``attended``, and is not asked."""

    def __init__(self, *, attended: bool) -> None:
        self.attended = attended

    def ask(self, text: str) -> str:
        raise RefusedError(f"a dry run cannot ask the operator; the question was: {text}")


def plan_run(request: RunRequest, *, attended: bool = False) -> PlannedRun:
    """Plan a run with all its checks.

    Parameters
    ----------
    attended : whether an operator could answer prompts; none is shown.

    Raises
    ------
    RefusedError
        For the reasons of :func:`~cbsr_qa.app.run.run.run_sensor`, except violated limits of the station: the result
        lists those.
    """
    plugins, checked, to_gate = check_request(request)
    seed = next(free_seeds(request.serial, to_gate.database)) if request.seed is None else request.seed
    configuration = request.configuration(seed)
    refuse_busy(configuration.station.name)
    answers = ask_before(replace(to_gate, preview=True), checked, plugins)
    control = Control.from_request(configuration, to_gate, _OfDryRun(attended=attended))
    with stoppable_outside_steps(), Session(configuration, plugins, control) as session:
        dry, forecasts = session.walk(), session.forecasts
    sensor = SensorIdentity(request.serial, request.batch, configuration.sensor_type.name)
    recipe = configuration.recipe.name
    with open_existing(to_gate.database) or nullcontext() as store:
        history = SensorHistory(sensor, recipe) if store is None else store.sensors.read_history(sensor, recipe)
    return PlannedRun.from_dry_run(dry, history, plugins.failures, answers, forecasts, request.operator)


def preview_gate(request: RunRequest, pin: Callable[[str], str] | None = None) -> CommandOutcome[GateShown]:
    """Ask the gate about a run; no instrument is opened.

    Parameters
    ----------
    pin : shows a text and returns the PIN of the operator; None: no PIN is asked for.

    Raises
    ------
    RefusedError
        For the reasons of :func:`~cbsr_qa.app.run.run.run_sensor`, except refusals of the gate: the result lists
        those.
    """
    plugins, configuration, to_gate = check_request(request)
    answers = ask_before(replace(to_gate, pin=pin, preview=pin is None), configuration, plugins)
    station = configuration.station
    return gate_outcome(
        request.serial,
        station.name,
        configuration.recipe.name,
        answers,
        asks_pin=asks_pin(station.gate, request.operator),
    )
