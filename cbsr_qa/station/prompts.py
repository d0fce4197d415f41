"""Prompts of a run: each has an identity and takes one answer, and both are events of the run."""

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Generic, TypeVar, cast

from cbsr_qa.domain.run.attendance import PromptAnswered, PromptShown
from cbsr_qa.station.control.desk import ControlDesk, Question
from cbsr_qa.system.clock import Clock

A = TypeVar("A")


class OperatorPrompt(Generic[A]):
    """Asks the operator, and knows while a question is open.

    Shared by the runner and instruments worked by hand.

    Parameters
    ----------
    ask : function that shows a text in the terminal and returns the answer; None without a terminal.
    desk : desk that shows prompts to others as well, and answers them if ``ask`` does not.
    operator : name of the person who answers in the terminal.
    first : number of the first prompt; a resumed run counts on.
    """

    def __init__(
        self,
        ask: Callable[[str], A] | None,
        desk: ControlDesk | None = None,
        *,
        operator: str = "",
        first: int = 0,
    ) -> None:
        self._ask, self._desk = ask, desk
        self._operator = operator or "the operator"
        self._next = first
        self._waiting = False
        self._emit: Callable[[PromptShown | PromptAnswered], None] | None = None

    def is_waiting(self) -> bool:
        return self._waiting

    def report_to(
        self, emit: Callable[[PromptShown | PromptAnswered], None], clock: Clock, phase: Callable[[], int]
    ) -> None:
        """Report prompts as events of a run from now on, if they are asked in this thread."""
        self._emit, self._clock, self._phase, self._thread = emit, clock, phase, threading.get_ident()

    def unheard(self) -> None:
        """Report no further prompts: the run is over, and the bench is being made safe."""
        self._emit = None

    def __call__(self, text: str, picture: str = "") -> A:
        question = Question(self._next, text, picture)
        self._next += 1
        self._tell(lambda phase, now_s: PromptShown(phase, question.prompt, text, Path(picture).name, now_s))
        self._waiting = True
        try:
            answer, answerer = self._await_answer(question)
        finally:
            self._waiting = False
        self._tell(lambda phase, now_s: PromptAnswered(phase, question.prompt, str(answer), answerer, now_s))
        return answer

    def _await_answer(self, question: Question) -> tuple[A, str]:
        if self._desk is not None and self._desk.answers:
            answer = self._desk.ask(question)
            return cast(A, answer.text), answer.by  # answers of people are always text
        assert self._ask is not None  # never called without an operator
        if self._desk is not None:
            self._desk.show(question)
        try:
            return self._ask(question.text), self._operator
        finally:
            if self._desk is not None:
                with suppress(Exception):
                    self._desk.show(None)

    def _tell(self, event: Callable[[int, float], PromptShown | PromptAnswered]) -> None:
        if self._emit is not None and threading.get_ident() == self._thread:
            self._emit(event(self._phase(), self._clock.now()))
