"""A run as others see it: it holds its station, reports its state, and takes requests."""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Self

from cbsr_qa.app.gate.request import GateRequest
from cbsr_qa.app.run.console import RunConsole
from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.steps import Press
from cbsr_qa.domain.run.run import RunEvent
from cbsr_qa.station.control.desk import ControlDesk
from cbsr_qa.station.control.lock import station_held
from cbsr_qa.station.control.messages import SensorUnderTest
from cbsr_qa.station.control.server import RunServer
from cbsr_qa.station.control.status import RunStatus
from cbsr_qa.station.interrupts import on_stderr
from cbsr_qa.station.plan import LoadKey, Plan, schedule


@dataclass(slots=True)
class Control:
    """What connects a run with the people at it, and with those who follow it over its channel.

    Parameters
    ----------
    console : the people at the run.
    sensor : which sensor is tested, where and how.
    """

    console: RunConsole
    desk: ControlDesk
    status: RunStatus
    sensor: SensorUnderTest
    _server: RunServer | None = field(default=None, init=False)

    @classmethod
    def from_request(
        cls, configuration: Configuration, asked: GateRequest, console: RunConsole, run: str | None = None
    ) -> Self:
        """Return the control of a run, not served yet. ``run``: its identifier if an earlier session began it."""
        station, recipe = configuration.station, configuration.recipe
        return cls(
            console,
            ControlDesk(answers=console.asks_by_channel),
            RunStatus(1.0 if station.clock == "real" else station.clock_speed),
            SensorUnderTest(run, station.name, recipe.name, asked.serial, asked.batch, asked.operator),
        )

    @property
    def subscribers(self) -> tuple[Callable[[RunEvent], None], ...]:
        """To call with every event: first what knows the state, then what sends it."""
        return (self.status, *([] if self._server is None else [self._server]))

    def tell(self, activity: str) -> None:
        """State what is done now."""
        self.status.doing(activity)
        self._notify()
        self.console.tell(activity)

    def begin(self, run: str) -> None:
        """State the identifier of a new run."""
        self.sensor = replace(self.sensor, run=run)
        self._notify()
        self.console.begin(run)

    def set_plan(self, plan: Plan, done: Collection[LoadKey]) -> None:
        """State what will be pressed, including what an earlier session has pressed."""
        phases = schedule(plan)
        presses = [
            ((phase.index, step.load), step.step)
            for phase in phases
            for step in phase.steps
            if isinstance(step.step, Press) and step.load is not None
        ]
        most = sum(phase.loads if phase.goal is None else phase.goal.at_most for phase in phases)
        names = {phase.index: phase.name for phase in phases}
        self.status.plan(names, presses, done, most if plan.decides else None)
        self._notify()

    @contextmanager
    def serve(self) -> Iterator[None]:
        """Hold the station, and serve the channel of the run while entered.

        Raises
        ------
        RefusedError
            If another process uses the station, or prompts could not be answered; nothing was moved or written.
        """
        sensor = self.sensor
        doing = f"testing {sensor.serial} with {sensor.recipe!r}"
        with (
            station_held(sensor.station, who=sensor.operator, doing=doing),
            RunServer(sensor.station, self.desk, lambda: self.sensor, self.status.whole) as server,
        ):
            self._server = server
            if server.why and self.desk.answers:
                raise RefusedError(server.why, remedy="prompts of this run are answered over the channel")
            if server.why:
                on_stderr(server.why)
            try:
                yield
            finally:
                self._server = None

    def _notify(self) -> None:
        if self._server is not None:
            self._server.state_changed()


@contextmanager
def open_control(
    configuration: Configuration, asked: GateRequest, console: RunConsole, run: str | None = None
) -> Iterator[Control]:
    """Serve the control of a run while entered; see :meth:`Control.from_request` and :meth:`Control.serve`."""
    control = Control.from_request(configuration, asked, console, run)
    with control.serve():
        yield control
