"""Progress display of a run on stderr: press, place, force, noise, current step, remaining time."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final, Self, TextIO

from cbsr_qa.domain.plan.steps import Release
from cbsr_qa.domain.run.attendance import RunContinued, RunPaused
from cbsr_qa.domain.run.events import (
    PhaseStarted,
    RunEnded,
    RunEvent,
    RunStarted,
    SamplesTaken,
    StepRetried,
    StepStarted,
)
from cbsr_qa.station.control.messages import Activity
from cbsr_qa.station.control.status import RunStatus
from cbsr_qa.station.noise import NoiseSoFar
from cbsr_qa.station.plan import duration
from cbsr_qa.system.clock import Clock, VirtualClock

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


#: Shortest interval between lines of a log beside those of phases and presses [s].
_QUIET_S: Final = 60.0


class RunProgress:
    """A subscriber that displays a run: a bar on a terminal, otherwise one line per phase and per press.

    The bar's thread only reads the clock, so that the time left counts down through a rest of four minutes without
    documents. On a virtual clock that does not wait a percentage is shown instead. Leaving the context removes the
    bar, even if the run was refused. The stream is by default stderr.

    Parameters
    ----------
    status : status of the run, with the press under way; it must see every event first.
    tell : function called with every line instead of showing a bar or printing.
    """

    def __init__(
        self,
        phases: int,
        clock: Clock,
        status: RunStatus,
        *,
        stream: TextIO | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        self._phases = phases
        self._clock = clock
        self._status = status
        self._noise = NoiseSoFar()
        self._said_s = time.monotonic()
        self._stream = stream or sys.stderr
        self._tell = tell
        self._phase: PhaseStarted | None = None
        self._bar: _Bar | None = None
        self._announced = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def __call__(self, event: RunEvent) -> None:
        self._noise(event)
        match event:
            case RunStarted() if self._tell is None and self._stream.isatty():
                self._bar = _Bar(self._clock, self._stream)
            case PhaseStarted():
                self._phase, self._announced = event, False
            case StepStarted():
                self._step(event)
            case SamplesTaken():
                self._show_force()
            case RunPaused(by=by):
                self._say(f"paused by {by}: the head is up; cbsr-qa station continue resumes the run")
            case RunContinued(by=by):
                self._say(f"continued by {by}")
            case StepRetried(attempt=attempt, why=why):
                self._say(f"attempt {attempt} failed, retrying: {why}")
            case RunEnded():
                self._close()

    def _step(self, event: StepStarted) -> None:
        if self._bar is not None:
            self._bar.set_times(event.time_s, event.remaining_s)
            self._bar.show(self._name(), self._live())
            return
        if not self._announced and self._phase is not None:
            self._announced = True
            self._say(f"{self._name()}: {duration(event.remaining_s)} of station time left")
        if isinstance(event.step, Release):  # the head is still down: its force is that of the hold
            activity = self._status.now()
            if activity.load is not None:
                self._say(f"{', '.join(self._figures(activity))}, {duration(event.remaining_s)} left")
        elif time.monotonic() - self._said_s >= _QUIET_S:
            self._say(f"{self._live()}, {duration(event.remaining_s)} left")

    def _show_force(self) -> None:
        """Show the latest force."""
        if self._bar is not None:
            self._bar.show(self._name(), self._live())
        elif time.monotonic() - self._said_s >= _QUIET_S:
            self._say(self._live())

    def _live(self) -> str:
        """Return press, place, force, noise and step as one line."""
        activity = self._status.now()
        figures = self._figures(activity)
        return f"{', '.join(figures)}: {activity.step}" if figures else activity.step

    def _figures(self, now: Activity) -> list[str]:
        load, force_N, percent = now.load, now.force_N, self._noise.percent
        figures = []
        if load is not None:
            place = f"{load.label} at ({load.x_mm:zg}, {load.y_mm:zg}) mm"
            figures.append(f"press {load.number} of {load.of}, {place}")
        if force_N is not None:
            figures.append(f"{round(force_N, 2) + 0.0:.2f} N")  # no minus before zero
        if percent is not None:
            figures.append(f"noise {percent:.2g} % of the reading")
        return figures

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Hide the bar during a question to the operator, and show it again."""
        bar = self._bar
        if bar is not None:
            bar.close()
        try:
            yield
        finally:
            if bar is not None and self._bar is bar:
                bar.show_again()

    def _name(self) -> str:
        if self._phase is None:
            return "setting up"
        return f"{self._phase.name} ({self._phase.index + 1} of {self._phases})"

    def _say(self, line: str) -> None:
        self._said_s = time.monotonic()
        if self._bar is not None:
            self._bar.say(line)
        elif self._tell is not None:
            self._tell(line)
        else:
            print(line, file=self._stream, flush=True)

    def _close(self) -> None:
        if self._bar is not None:
            bar, self._bar = self._bar, None
            with suppress(OSError):  # the terminal may close before the run ends
                bar.close()


class _Bar:
    """The bar on a terminal; rich is imported only for it."""

    def __init__(self, clock: Clock, stream: TextIO) -> None:
        self._clock = clock
        self._total_s: float | None = None
        self._ends_s = 0.0
        self._bar, self._task = _rich_bar(stream, self._format_remaining)
        self._bar.start()

    def set_times(self, now_s: float, remaining_s: float) -> None:
        self._total_s = max(self._total_s or 0.0, remaining_s)
        self._ends_s = now_s + remaining_s
        self._bar.update(self._task, total=self._total_s, completed=self._total_s - remaining_s)

    def show(self, phase: str, doing: str) -> None:
        self._bar.update(self._task, phase=phase, doing=doing)

    def say(self, line: str) -> None:
        self._bar.console.print(line, markup=False, highlight=False)

    def show_again(self) -> None:
        self._bar.start()

    def close(self) -> None:
        self._bar.stop()

    def _format_remaining(self, percentage: float) -> str:
        speed = self._clock.speed if isinstance(self._clock, VirtualClock) else 1.0
        if speed is None:
            return f"{percentage:3.0f} %"
        left_s = max(self._ends_s - self._clock.now(), 0.0) / speed
        return f"{duration(left_s)} left"


def _rich_bar(stream: TextIO, left: Callable[[float], str]) -> "tuple[Progress, TaskID]":
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, Task
    from rich.text import Text

    class Fields(ProgressColumn):
        """Phase and activity as plain text: names in a recipe are not markup."""

        def render(self, task: Task) -> Text:
            return Text.assemble((task.fields["phase"], "bold"), "  ", task.fields["doing"])

    class Left(ProgressColumn):
        """Time left by the clock, or percent."""

        def render(self, task: Task) -> Text:
            return Text(left(task.percentage))

    console = Console(file=stream)
    bar = Progress(BarColumn(bar_width=24), Left(), Fields(), console=console, transient=True)
    return bar, bar.add_task("run", total=None, phase="setting up", doing="")
