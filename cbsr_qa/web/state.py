"""State of a station, put together from the run's channel, the station's lock and the store."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from time import monotonic
from typing import Any

from cbsr_qa.domain.plan.limits import FailureCode
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.states import EndReason, ResultState
from cbsr_qa.store.runs.live import RunLook
from cbsr_qa.web.live_run import DrawnPlaces, LiveView


class Mode(StrEnum):
    """Activity of a station."""

    READY = "ready"  #: nothing runs, and nothing has run
    STARTING = "starting"  #: a process was started, and has not answered yet
    RUNNING = "running"
    PAUSED = "paused"
    ASKING = "asking"  #: a prompt waits for an answer
    CONCLUDING = "concluding"  #: measuring is over; the result is worked out and written
    DONE = "done"  #: the last run has ended, also one that was stopped or broke
    UNSAFE = "unsafe"  #: an emergency stop or a fault ended the last run; nobody has confirmed the bench since
    INTERRUPTED = "interrupted"  #: the run's process has gone without an end
    HELD = "held"  #: something else uses the station

    @property
    def runs(self) -> bool:
        """Whether a process works at the station."""
        return self not in (Mode.READY, Mode.DONE, Mode.UNSAFE, Mode.INTERRUPTED)

    @property
    def live(self) -> bool:
        """Whether frames may come."""
        return self in (Mode.RUNNING, Mode.PAUSED, Mode.ASKING, Mode.CONCLUDING)


@dataclass(frozen=True, slots=True)
class Prompt:
    """A question to the operator. ``picture`` says whether there is one."""

    number: int
    text: str
    picture: bool


@dataclass(frozen=True, slots=True)
class Control:
    """State of a run by its channel; see docs/decisions/0041.

    Parameters
    ----------
    run : identifier of the run; empty before it has begun.
    step : the step in words.
    place : label of the load under the head; empty for none. ``x_mm``, ``y_mm``: where the head is.
    number, of : number of the press under way or next, and number of all; 0 for none.
    ends_at : expected end of the run, by ``time.monotonic`` [s]; None if unknown, or if its clock does not wait.
    paused_by, pause_wanted_by : person who paused the run, or asked for a pause; None for nobody.
    """

    run: str
    serial: str
    recipe: str
    phase: str
    step: str
    place: str
    x_mm: float | None
    y_mm: float | None
    number: int
    of: int
    ends_at: float | None
    paused_by: str | None
    pause_wanted_by: str | None
    prompt: Prompt | None
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FailedLimit:
    """A limit that decided the latest run's outcome, or how it was cut off.

    Parameters
    ----------
    words : value and limit; empty for a run that was cut off.
    code : failure code with what it means and what to do with the sensor; None without one.
    measurement : the judged measurement; None for a run that was cut off.
    """

    words: str
    code: FailureCode | None = None
    measurement: Measurement | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Content of the pages on a station at one time.

    Parameters
    ----------
    control : state of the run in progress, by its channel; None without a run, or before it answers.
    look : latest stored run; None before the first.
    failed : limits that decided the latest run's outcome, unless it passed; worst first.
    failed_before : the run of its sensor and recipe before it, if both failed.
    standing_failure : a failure of its sensor with another recipe, if the latest run passed; None without one.
    todo : what is done with the sensor by that failure; empty if its recipe does not say.
    live : view of the run in progress; None without one.
    starting : sensor of the run that was started last; empty if none was, or by an earlier server.
    refused : reason why the run that was started last never began; empty otherwise.
    cancelled : whether somebody cancelled its start.
    trouble : reason why the store cannot be read, or the run cannot be followed; empty otherwise.
    health, healthy : state of the station in words, and whether it is in order.
    drawn : sheet and places of the latest run, if a limit of a place decided its outcome.
    confirmed_by : who said that the bench is safe after the latest run; empty for nobody.
    """

    station: str
    mode: Mode
    control: Control | None
    look: RunLook | None
    failed: tuple[FailedLimit, ...]
    failed_before: RunLook | None
    live: LiveView | None
    starting: str
    refused: str
    trouble: str
    health: str
    healthy: bool
    drawn: DrawnPlaces | None = None
    confirmed_by: str = ""
    standing_failure: RunLook | None = None
    todo: str = ""
    cancelled: bool = False

    @property
    def not_started(self) -> str:
        """The sensor at the station whose run never began; empty for none."""
        return self.starting if self.refused and self.mode in (Mode.READY, Mode.DONE) else ""

    @property
    def serial(self) -> str:
        """The sensor at the station; empty for none."""
        if self.control is not None:
            return self.control.serial
        if self.mode is Mode.STARTING or self.not_started:
            return self.starting
        return "" if self.look is None else self.look.serial

    @property
    def shows_look(self) -> bool:
        """Whether the latest run is shown: once another sensor lies there, only if it can be resumed."""
        is_of_another = self.look is not None and self.not_started not in ("", self.look.serial)
        return self.look is not None and (self.resumable or not is_of_another)

    @property
    def resumable(self) -> bool:
        """Whether the latest run can be continued."""
        look = self.look
        if look is None or self.mode.runs or self.mode is Mode.UNSAFE or look.altered:
            return False
        return look.result is not ResultState.STORED


def mode_of(
    control: Control | None,
    look: RunLook | None,
    *,
    held: bool,
    starting: bool,
    begun: bool = False,
    unsafe: bool = False,
) -> Mode:
    """Decide what a station is doing.

    Parameters
    ----------
    held : whether a process holds the station's lock.
    starting : whether a process that this page started is alive.
    begun : whether ``look`` is of that process.
    unsafe : whether the end of ``look`` needs a confirmation that nobody has given.
    """
    has_ended = (
        control is not None and look is not None and look.run == control.run and look.end is not EndReason.RUNNING
    )
    if control is not None and not has_ended:
        if control.prompt is not None:
            return Mode.ASKING
        return Mode.RUNNING if control.paused_by is None else Mode.PAUSED
    if held or starting:
        is_unjudged = look is not None and look.result is ResultState.MISSING and not look.altered
        if is_unjudged or control is not None or (starting and begun):
            return Mode.CONCLUDING
        return Mode.STARTING if starting else Mode.HELD
    if look is None or look.end is EndReason.RUNNING:
        return Mode.READY if look is None else Mode.INTERRUPTED
    return Mode.UNSAFE if unsafe else Mode.DONE


def control_of(hello: Mapping[str, Any], state: Mapping[str, Any], *, down: bool) -> Control:
    """Read the documents of a run's channel.

    Parameters
    ----------
    down : whether the head is on its way down, or pressed.

    Raises
    ------
    KeyError, TypeError, ValueError
        If they are malformed.
    """
    load, prompt, paused, pause_wanted = (state.get(key) for key in ("load", "prompt", "paused", "pause_wanted"))
    press = state.get("next") if load is None else load
    remaining_s, speed = state.get("remaining_s"), state.get("clock_speed")
    ends_at = None
    if remaining_s is not None and speed is not None:  # otherwise it is unknown, or the run's clock does not wait
        ends_at = monotonic() + float(remaining_s) / float(speed)
    return Control(
        run=str(state.get("run") or ""),  # known once its first row is stored, which may be after the hello
        serial=str(hello["serial"]),
        recipe=str(hello["recipe"]),
        phase=str(state.get("phase") or ""),
        step=str(state.get("step") or ""),
        place=str(load["label"]) if load and down else "",
        x_mm=float(load["x_mm"]) if load and down else None,
        y_mm=float(load["y_mm"]) if load and down else None,
        number=0 if press is None else int(press["number"]),
        of=0 if press is None else int(press["of"]),
        ends_at=ends_at,
        paused_by=None if paused is None else str(paused.get("by") or ""),
        pause_wanted_by=str(pause_wanted) if pause_wanted else None,
        prompt=None
        if prompt is None
        else Prompt(int(prompt["prompt"]), str(prompt["text"]), bool(prompt["picture"])),
        warnings=tuple(map(str, state.get("warnings") or ())),
    )
