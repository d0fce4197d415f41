"""A numerically hard case: its difficulty, its truth, and its result."""

import inspect
import math
import signal
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from time import perf_counter
from types import FrameType
from typing import Final, TypeVar

import numpy as np

from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.domain.filling import fill_from_object

#: Largest relative error by conditioning, in units of condition number times machine precision.
CONDITIONING_ROOM: Final = 100.0
#: Time limit of a case; the longest takes a few seconds.
LONGEST_S: Final = 120.0
EPSILON: Final = float(np.finfo(np.float64).eps)


class Ending(StrEnum):
    """Outcome of a hard case."""

    OK = "ok"  #: a number within its bound
    REFUSED = "refused"  #: refused with reason and remedy, as it should be
    BROKEN = "broken"  #: out of its bound, not finite, an unexplained error or warning, or an unexpected refusal


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer of a hard case.

    Parameters
    ----------
    error : relative to truth, not negative; relative unless ``unit`` states otherwise.
    condition : condition number of the solved system; None without one.
    unit : unit of error and bound; ``"1"`` for relative ones.
    """

    error: float
    bound: float
    condition: float | None = None
    unit: str = "1"
    note: str = ""


@dataclass(frozen=True, slots=True)
class HardCase:
    """A numerically hard case: its difficulty, for an engineer, and its truth.

    Parameters
    ----------
    run : gives the answer, or raises the refusal.
    refuses : the correct error of this case; None if it has an answer.
    """

    name: str
    area: str
    hard: str
    truth: str
    run: Callable[[], Answer | None]
    refuses: type[CbsrError] | None = None


_Run = TypeVar("_Run", bound=Callable[[], Answer | None])


class Area:
    """Cases that belong together, in the order their functions are defined.

    A case has the name of its function, with hyphens. The docstring says what makes it hard.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.cases: list[HardCase] = []

    def against(self, truth: str) -> Callable[[_Run], _Run]:
        """Add a case whose answer is compared with a truth."""
        return partial(self._add, truth, None)

    def refuses(self, error: type[CbsrError], truth: str = "refusal") -> Callable[[_Run], _Run]:
        """Add a case that must raise an error."""
        return partial(self._add, truth, error)

    def _add(self, truth: str, refuses: type[CbsrError] | None, run: _Run) -> _Run:
        hard = " ".join((inspect.getdoc(run) or "").split())
        self.cases.append(HardCase(run.__name__.replace("_", "-"), self.name, hard, truth, run, refuses))
        return run


@dataclass(frozen=True, slots=True)
class CaseResult:
    """Result of a hard case.

    Parameters
    ----------
    outcome : within its bound, refused as it should be, or broken.
    error, bound, unit, condition, note : attributes of the answer; None if it was refused, failed, or is not finite.
    reason : reason for the refusal or failure; None if within its bound.
    remedy : action for the user, or None.
    """

    name: str
    area: str
    hard: str
    truth: str
    outcome: Ending
    error: float | None
    bound: float | None
    unit: str | None
    condition: float | None
    reason: str | None
    remedy: str | None
    note: str | None
    seconds: float


def condition_bound(condition: float, floor: float = 0.0) -> float:
    """Bound of a relative error from a condition number: 100 times it times machine precision, at least a floor."""
    return max(floor, CONDITIONING_ROOM * condition * EPSILON)


def answer_from_condition(error: float, condition: float, *, unit: str = "1", note: str = "") -> Answer:
    """Answer with an error bound from its condition number."""
    return Answer(error, condition_bound(condition), condition, unit, note)


def examine(case: HardCase, *, longest_s: float = LONGEST_S) -> CaseResult:
    """Run a case; a warning of numpy or scipy, or a timeout, counts as an unexplained answer."""
    started_s = perf_counter()
    answer, reason, remedy, outcome = None, "", "", Ending.BROKEN
    try:
        with warnings.catch_warnings(), _limit_time(longest_s):
            warnings.simplefilter("error")
            answer = case.run()
        reason = _why_broken(case, answer)
        outcome = Ending.BROKEN if reason else Ending.OK
    except CbsrError as refusal:
        reason, remedy = refusal.reason, refusal.remedy
        if case.refuses is None or not isinstance(refusal, case.refuses):
            reason = f"refused without need: {reason}"
        elif reason:
            outcome = Ending.REFUSED
    except Exception as error:  # noqa: BLE001  # any error: a broken case is shown, and does not end the table
        reason = f"{type(error).__name__}: {error}"
    shown_answer = answer or Answer(math.nan, math.nan)
    return fill_from_object(
        CaseResult,
        case,
        outcome=outcome,
        error=_finite(shown_answer.error),
        bound=_finite(shown_answer.bound),
        unit=shown_answer.unit if answer else None,
        condition=_finite(shown_answer.condition),
        reason=reason or None,
        remedy=remedy or None,
        note=shown_answer.note or None,
        seconds=round(perf_counter() - started_s, 3),
    )


@contextmanager
def _limit_time(seconds: float) -> Iterator[None]:
    """Raise TimeoutError after some seconds, if the system has timers and this is the main thread."""
    if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"no end within {seconds:g} s")

    previous_handler = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous_handler)


def _why_broken(case: HardCase, answer: Answer | None) -> str:
    """Why an answer breaks its case; empty if it is within its bound."""
    if case.refuses is not None:
        return f"a number where {case.refuses.__name__} was to be raised"
    assert answer is not None  # of a case with an answer
    if not (math.isfinite(answer.error) and math.isfinite(answer.bound)):
        return "its error or its bound is no finite number"
    is_within = 0 <= answer.error <= answer.bound
    return "" if is_within else f"an error of {answer.error:.3g} where {answer.bound:.3g} is allowed"


def _finite(value: float | None) -> float | None:
    """Return a finite number, or None: JSON has no NaN."""
    return float(value) if value is not None and math.isfinite(value) else None
