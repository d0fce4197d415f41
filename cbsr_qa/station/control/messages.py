"""Lines of a run's channel: each is one JSON object, whose keys are the fields here.

The first line is a :class:`Hello`. A :class:`State` follows whenever it changes, among the run's events (see
``cbsr_qa.domain.run``), and a :class:`Reply` every request. ``cbsr-qa schema channel`` prints their JSON Schema.
"""

from dataclasses import dataclass
from typing import Literal

from cbsr_qa.domain.run.states import EndReason


@dataclass(frozen=True)
class PlannedLoad:
    """A press of the plan: its phase's name, its place and strain (a fraction), and whether it is done."""

    phase: str
    label: str
    x_mm: float
    y_mm: float
    strain: float
    trial: int
    done: bool


@dataclass(frozen=True)
class Numbered:
    """Which press, counted from 1, of how many."""

    number: int
    of: int


@dataclass(frozen=True)
class LoadUnderWay(PlannedLoad, Numbered):
    """The press under way."""


@dataclass(frozen=True, slots=True)
class Ended:
    """How a run ended."""

    end: EndReason
    detail: str


@dataclass(frozen=True)
class Activity:
    """What a run does.

    Parameters
    ----------
    run : its identifier; None before it is stored.
    phase, phases : name of the sequence under way; number of sequences.
    step : what is done now, in words.
    load, next : the press under way, and which one is next: one of them is None.
    remaining_s : expected station time to the end; None if unknown.
    time_s : of the last force or step, on the run's clock.
    force_N : last force; None without a finite one.
    clock_speed : station seconds per second; None if the clock does not wait.
    loads : the plan; None in lines that do not repeat it.
    """

    run: str | None = None
    phase: str | None = None
    phases: int = 0
    step: str = "opening the bench"
    load: LoadUnderWay | None = None
    next: Numbered | None = None
    remaining_s: float | None = None
    time_s: float = 0.0
    force_N: float | None = None
    ended: Ended | None = None
    clock_speed: float | None = None
    loads: tuple[PlannedLoad, ...] | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Paused:
    """Who paused the run, and since when on the run's clock."""

    by: str
    since_s: float


@dataclass(frozen=True, slots=True)
class OpenPrompt:
    """The open prompt. ``picture``: path of an image file, or empty; ``here``: whether the channel takes answers."""

    prompt: int
    text: str
    picture: str
    here: bool


@dataclass(frozen=True)
class Requests:
    """What people asked of a run, and what it asks them.

    Parameters
    ----------
    pause_wanted, stopping : who asked for a pause that has not begun, or for the end; None for nobody.
    """

    paused: Paused | None = None
    pause_wanted: str | None = None
    stopping: str | None = None
    prompt: OpenPrompt | None = None


@dataclass(frozen=True)
class State(Activity, Requests):
    """The state of a run."""

    type: Literal["state"] = "state"

    @classmethod
    def from_parts(cls, activity: Activity, requests: Requests) -> "State":
        return cls(**vars(activity), **vars(requests))


@dataclass(frozen=True, slots=True)
class SensorUnderTest:
    """Which sensor is tested, where and how. ``run``: its identifier; None before it is stored."""

    run: str | None
    station: str
    recipe: str
    serial: str
    batch: str
    operator: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Hello(SensorUnderTest):
    """First line for every client. ``pid``: of the process that drives the bench."""

    type: Literal["hello"] = "hello"
    protocol: int
    pid: int
    state: State


@dataclass(frozen=True, slots=True)
class Reply:
    """Whether a request was taken, else why not. ``id``: of the request; ``state``: if it asked for that."""

    type: Literal["reply"]
    id: int | str | None
    ok: bool
    why: str = ""
    state: State | None = None


@dataclass(frozen=True, slots=True)
class Refused:
    """Why a connection is closed at once."""

    type: Literal["refused"]
    why: str


#: What a run says on its channel, its events aside.
ChannelLine = Hello | State | Reply | Refused
