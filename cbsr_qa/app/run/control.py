"""A run as others see it: it holds its station, reports its state, and takes requests."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

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
    """What connects a run and its channel.

    Parameters
    ----------
    sensor : which sensor is tested, where and how.
    """

    desk: ControlDesk
    status: RunStatus
    sensor: SensorUnderTest
    _server: RunServer | None = field(default=None, init=False)

    @property
    def subscribers(self) -> tuple[Callable[[RunEvent], None], ...]:
        """To call with every event: first what knows the state, then what sends it."""
        return (self.status, *([] if self._server is None else [self._server]))

    @property
    def operator(self) -> str:
        return self.sensor.operator

    def set_run(self, run: str) -> None:
        """State the run's identifier."""
        self.sensor = replace(self.sensor, run=run)
        self._notify()

    def begins(self, begun: Callable[[str], None]) -> Callable[[str], None]:
        """Return what is called with a run's identifier, and states it here too."""

        def both(run: str) -> None:
            self.set_run(run)
            begun(run)

        return both

    def set_plan(self, plan: Plan, done: frozenset[LoadKey]) -> None:
        """State what will be pressed, including what an earlier session has pressed."""
        phases = schedule(plan)
        presses = [
            ((phase.index, step.load), step.step)
            for phase in phases
            for step in phase.steps
            if isinstance(step.step, Press) and step.load is not None
        ]
        self.status.plan({phase.index: phase.name for phase in phases}, presses, done)
        self._notify()

    def telling(self, tell: Callable[[str], None]) -> Callable[[str], None]:
        """Return a listener of stages that states them here too."""

        def tell_both(stage: str) -> None:
            self.status.doing(stage)
            self._notify()
            tell(stage)

        return tell_both

    @contextmanager
    def serve(self, station: str, warn: Callable[[str], None]) -> Iterator[None]:
        """Serve the channel while entered. ``warn``: called if there can be none.

        Raise RefusedError if there can be none, and prompts are answered over it.
        """
        with RunServer(station, self.desk, lambda: self.sensor, self.status.whole) as server:
            self._server = server
            if server.why and self.desk.answers:
                raise RefusedError(server.why, remedy="prompts of this run are answered over the channel")
            if server.why:
                warn(server.why)
            try:
                yield
            finally:
                self._server = None

    def _notify(self) -> None:
        if self._server is not None:
            self._server.state_changed()


@contextmanager
def open_control(
    configuration: Configuration, *, serial: str, batch: str, operator: str, answers: bool
) -> Iterator[Control]:
    """Hold the station of a run and serve its channel while entered.

    Parameters
    ----------
    answers : whether prompts are answered over the channel, not in the terminal.

    Raises
    ------
    RefusedError
        If another process uses the station, or prompts could not be answered; nothing was moved or written.
    """
    station, recipe = configuration.station, configuration.recipe.name
    status = RunStatus(1.0 if station.clock == "real" else station.clock_speed)
    sensor = SensorUnderTest(None, station.name, recipe, serial, batch, operator)
    control = Control(ControlDesk(answers=answers), status, sensor)
    with (
        station_held(station.name, who=operator, doing=f"testing {serial} with {recipe!r}"),
        control.serve(station.name, on_stderr),
    ):
        yield control
