"""A run as others see it: it holds its station, reports its state, and takes requests.

After an emergency stop no run begins at its station before somebody has confirmed that the bench is safe.
"""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from cbsr_qa.app.gate.request import GateRequest
from cbsr_qa.app.run.console import RunConsole
from cbsr_qa.config.merging import Configuration
from cbsr_qa.config.paths import var_folder, writable_folder
from cbsr_qa.domain.errors import AT_COMMAND_LINE, ConfigError, RefusedError
from cbsr_qa.domain.plan.steps import Press
from cbsr_qa.domain.run.events import RunEvent
from cbsr_qa.station.control.desk import ControlDesk
from cbsr_qa.station.control.lock import station_held
from cbsr_qa.station.control.messages import SensorUnderTest
from cbsr_qa.station.control.server import RunServer
from cbsr_qa.station.control.status import RunStatus
from cbsr_qa.station.interrupts import on_stderr
from cbsr_qa.station.plan import LoadKey, Plan, schedule
from cbsr_qa.store.opening import open_existing


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
    """Serve the control of a run while entered; see :meth:`Control.from_request` and :meth:`Control.serve`.

    RefusedError also if an emergency stop ended the latest run of the station, and nobody has confirmed the bench.
    """
    station = configuration.station.name
    if (stopped := find_unconfirmed_stop(station, asked.database)) is not None:
        raise RefusedError(
            f"an emergency stop ended run {stopped[0]}, the latest at station {station}; nobody has confirmed since"
            " that the bench is safe",
            remedy="look at the head, the current source and the sensor, then confirm\n"
            f"{AT_COMMAND_LINE}cbsr-qa station confirm {station} --by NAME",
        )
    control = Control.from_request(configuration, asked, console, run)
    with control.serve():
        yield control


def find_unconfirmed_stop(station: str, database: str) -> tuple[str, datetime] | None:
    """Return run and begin of the latest session at a station if it was stopped at once and is not confirmed."""
    with open_existing(database) or nullcontext() as store:
        stopped = None if store is None else store.runs.find_emergency_stop(station)
    return None if stopped is None or is_confirmed(*stopped) else stopped


def is_confirmed(run: str, session_at: datetime) -> bool:
    """Whether somebody has confirmed that the bench is safe after a session of a run."""
    return _confirmation(run, session_at).exists()


def read_confirmer(run: str, session_at: datetime, station: str) -> str:
    """Return who has confirmed that the bench is safe after a session of a run; empty for nobody, or if unknown."""
    try:
        line = _confirmation(run, session_at).read_text(encoding="utf-8")
    except (OSError, ValueError):
        return ""
    return line.removeprefix(f"{station}: ").rpartition(", ")[0]


def confirm_bench(run: str, session_at: datetime, station: str, by: str) -> None:
    """Store that the bench is safe after a session of a run, and who says so. ConfigError if that is impossible."""
    file = _confirmation(run, session_at)
    writable_folder(file.parent)
    try:
        file.write_text(f"{station}: {by}, {datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{file} cannot be written: {error.strerror or error}") from error


def _confirmation(run: str, session_at: datetime) -> Path:
    """Return the file that confirms a session: a run that is resumed may be stopped at once again."""
    return var_folder() / "control" / "confirmed" / f"{run}-{session_at:%Y%m%dT%H%M%S%f}"
