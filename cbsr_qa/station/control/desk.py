"""Requests to a run from other threads, and the one open prompt."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

from cbsr_qa.domain.errors import AbortedError, RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.station.control.messages import OpenPrompt, Paused, Requests

#: Longest wait between looks for a change [s, real time].
_LOOK_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class Question:
    """A prompt. ``prompt``: identity within the run; ``picture``: path of an image file, empty without one."""

    prompt: int
    text: str
    picture: str = ""


@dataclass(frozen=True, slots=True)
class Answer:
    """The one answer to a prompt, and who gave it."""

    text: str
    by: str


class Brakes(Protocol):
    """What stops a run under way; both return at once, and whether the run will stop."""

    def stop(self, by: str) -> bool: ...

    def emergency(self, by: str) -> bool: ...


class ControlDesk:
    """Requests for a run, made in any thread. The run's own thread looks at them where it may wait.

    A request that cannot be met raises RefusedError, whose reason goes to the person who asked.

    Parameters
    ----------
    answers : whether prompts are answered here; otherwise they are only shown here.
    """

    def __init__(self, *, answers: bool = False) -> None:
        self.answers = answers
        #: Called after each change, in any thread.
        self.changed: Callable[[], None] = lambda: None
        self._lock = threading.Lock()
        self._woken = threading.Event()
        self._brakes: Brakes | None = None
        self._wanted_by: str | None = None
        self._paused: tuple[str, float] | None = None
        self._continued_by: str | None = None
        self._stopped_by: str | None = None
        self._question: Question | None = None
        self._answer: Answer | None = None
        self._answered: dict[int, str] = {}

    # Called for people, from any thread.

    def pause(self, by: str) -> None:
        """Ask for a pause before the next press."""
        with self._lock:
            if self._paused is not None:
                raise RefusedError(f"the run is paused already, by {self._paused[0]}")
            if self._wanted_by is not None:
                raise RefusedError(f"{self._wanted_by} has asked for a pause already; the load under way ends first")
            if self._brakes is None:
                raise RefusedError("the run does not move now, so it cannot be paused")
            self._wanted_by, self._continued_by = by, None
        self._wake()

    def resume(self, by: str) -> None:
        """End a pause, or withdraw the request for one."""
        with self._lock:
            if self._paused is None and self._wanted_by is None:
                raise RefusedError("the run is not paused")
            self._wanted_by, self._continued_by = None, by
        self._wake()

    def stop(self, by: str) -> None:
        """Stop the run in order: a press under way is completed."""
        with self._lock:
            if self._stopped_by is not None:
                raise RefusedError(f"the run stops already, as {self._stopped_by} has asked")
            brakes, asked = self._brakes, self._question is not None and self.answers
            self._stopped_by = by
        if not (brakes is not None and brakes.stop(by)) and not asked:
            with self._lock:
                self._stopped_by = None
            raise RefusedError("the run does not move now: there is nothing to stop")
        self._wake()

    def emergency(self, by: str) -> None:
        """Make the bench safe at once."""
        with self._lock:
            brakes, asked = self._brakes, self._question is not None and self.answers
        if brakes is None and asked:  # a prompt while the bench is being opened: nothing moves
            self.stop(by)
            return
        if brakes is None or not brakes.emergency(by):
            raise RefusedError("the run does not move now: there is nothing to stop")
        with self._lock:
            self._stopped_by = self._stopped_by or by
        self._wake()

    def answer(self, prompt: int, text: str, by: str) -> None:
        """Answer the open prompt; only the first answer counts."""
        with self._lock:
            if prompt in self._answered:
                raise RefusedError(f"prompt {prompt} has been answered by {self._answered[prompt]}")
            if self._question is None or self._question.prompt != prompt:
                raise RefusedError(f"prompt {prompt} is not open")
            if not self.answers:
                raise RefusedError("this run asks in its terminal: answer there")
            self._answer = Answer(text, by)
            self._answered[prompt] = by
        self._wake()

    def state(self) -> Requests:
        """Return what a page shows of requests and the open prompt."""
        with self._lock:
            asked = self._question
            return Requests(
                paused=None if self._paused is None else Paused(*self._paused),
                pause_wanted=self._wanted_by,
                stopping=self._stopped_by,
                prompt=None if asked is None else fill_from_object(OpenPrompt, asked, here=self.answers),
            )

    # Called by the run, in its own thread.

    def open(self, brakes: Brakes) -> None:
        """Begin to take requests for a run under way; one to stop that came before is passed on."""
        with self._lock:
            self._brakes, by = brakes, self._stopped_by
        if by is not None:
            brakes.stop(by)

    def close(self) -> None:
        """Take no more requests: the bench is safe, or is being made safe."""
        with self._lock:
            self._brakes = self._paused = self._wanted_by = None
        self._wake()

    def pause_wanted(self) -> str | None:
        """Return who wants a pause; None if nobody does, or the request was withdrawn."""
        return self._wanted_by

    def begin_pause(self, by: str, now_s: float) -> None:
        """State that the run is paused, and that this is stored."""
        with self._lock:
            self._wanted_by, self._paused = None, (by, now_s)
        self._wake()

    def name_continuer(self) -> str | None:
        """Return who has ended the pause; None while it lasts."""
        with self._lock:
            if self._continued_by is None:
                return None
            self._paused = None
        self.changed()
        return self._continued_by

    def wait(self, longest_s: float) -> None:
        """Wait in real time until somebody asks for something, at most so long."""
        self._woken.wait(min(longest_s, _LOOK_S))
        self._woken.clear()

    def show(self, question: Question | None) -> None:
        """Show a prompt that is asked elsewhere; None: no longer."""
        with self._lock:
            self._question, self._answer = question, None
        self._wake()

    def ask(self, question: Question) -> Answer:
        """Show a prompt and wait for its answer.

        Raises
        ------
        AbortedError
            If the run was stopped meanwhile, and no signal's handler has said so first.
        """
        self.show(question)
        try:
            while True:
                with self._lock:
                    if self._stopped_by is not None:
                        raise AbortedError(self._stopped_by)
                    if self._answer is not None:
                        return self._answer
                self.wait(_LOOK_S)
        finally:
            self.show(None)

    def _wake(self) -> None:
        self._woken.set()
        self.changed()
