"""What an operator did while a run was under way: pauses between loads, and answers to prompts."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True, slots=True)
class RunPaused:
    """The run waits between two presses, with the head up. ``by``: who asked for it."""

    type: Literal["run_paused"] = field(default="run_paused", kw_only=True, repr=False)
    phase: int
    time_s: float
    by: str


@dataclass(frozen=True, slots=True)
class RunContinued:
    """A pause has ended. ``by``: who asked for it."""

    type: Literal["run_continued"] = field(default="run_continued", kw_only=True, repr=False)
    phase: int
    time_s: float
    by: str


@dataclass(frozen=True, slots=True)
class PromptShown:
    """The operator is asked something. ``prompt`` names it within the run, ``picture`` is an image's file name."""

    type: Literal["prompt_shown"] = field(default="prompt_shown", kw_only=True, repr=False)
    phase: int
    prompt: int
    text: str
    picture: str
    time_s: float


@dataclass(frozen=True, slots=True)
class PromptAnswered:
    """The answer to a prompt, and who gave it."""

    type: Literal["prompt_answered"] = field(default="prompt_answered", kw_only=True, repr=False)
    phase: int
    prompt: int
    answer: str
    by: str
    time_s: float


AttendanceEvent = RunPaused | RunContinued | PromptShown | PromptAnswered


@dataclass(frozen=True, slots=True)
class Pause:
    """A pause of a run; the rest before the next press was longer by it.

    Parameters
    ----------
    phase : index of the phase it was in.
    started_s, ended_s : start and end on the run's clock [s]; no end if the run ended or was cut off in it.
    by, continued_by : people who asked for its start and its end; the latter is empty without an end.
    """

    phase: int
    started_s: float
    ended_s: float | None
    by: str
    continued_by: str = ""

    @property
    def duration_s(self) -> float | None:
        return None if self.ended_s is None else self.ended_s - self.started_s


@dataclass(frozen=True, slots=True)
class AskedPrompt:
    """A prompt with its answer.

    Parameters
    ----------
    shown_s, answered_s : times of question and answer on the run's clock [s]; no answer if the run ended or was cut
        off before.
    answer, by : empty without an answer.
    """

    phase: int
    prompt: int
    text: str
    picture: str
    shown_s: float
    answered_s: float | None = None
    answer: str = ""
    by: str = ""


def pauses_of(events: Iterable[AttendanceEvent]) -> tuple[Pause, ...]:
    """Return the pauses among events in their order."""
    pauses: list[Pause] = []
    for event in events:
        if isinstance(event, RunPaused):
            pauses.append(Pause(event.phase, event.time_s, None, event.by))
        elif isinstance(event, RunContinued) and pauses:
            last = pauses[-1]
            pauses[-1] = Pause(last.phase, last.started_s, event.time_s, last.by, event.by)
    return tuple(pauses)


def prompts_of(events: Iterable[AttendanceEvent]) -> tuple[AskedPrompt, ...]:
    """Return the prompts among events in their order."""
    prompts: dict[int, AskedPrompt] = {}
    for event in events:
        if isinstance(event, PromptShown):
            prompt_fields = (event.phase, event.prompt, event.text, event.picture, event.time_s)
            prompts[event.prompt] = AskedPrompt(*prompt_fields)
        elif isinstance(event, PromptAnswered) and event.prompt in prompts:
            asked = prompts[event.prompt]
            prompt_fields = (asked.phase, asked.prompt, asked.text, asked.picture, asked.shown_s)
            prompts[event.prompt] = AskedPrompt(*prompt_fields, event.time_s, event.answer, event.by)
    return tuple(prompts.values())
