"""A numerically hard case: what makes it hard, what it is held against, and how it came out."""

import inspect
import math
import signal
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from time import perf_counter
from types import FrameType
from typing import Final, TypeAlias, TypeVar

import numpy as np

from cbsr_qa.domain import CbsrError

#: Relative accuracy may be lost to conditioning up to this many times condition number times machine precision.
CONDITIONING_ROOM: Final = 100.0
#: A case that takes longer hangs; the longest takes a few seconds.
LONGEST_S: Final = 120.0
EPSILON: Final = float(np.finfo(np.float64).eps)


class Ending(StrEnum):
    """How a hard case came out."""

    OK = "ok"  #: a number within its bound
    REFUSED = "refused"  #: refused with reason and remedy, as it should be
    BROKEN = "broken"  #: out of its bound, not finite, an unexplained error or warning, or a refusal not asked for


@dataclass(frozen=True, slots=True)
class Answer:
    """What a hard case gave.

    Parameters
    ----------
    error : against truth, not negative; relative where nothing else is said.
    condition : number of what was solved; None where nothing is solved.
    unit : of error and bound; ``"1"`` for relative ones.
    """

    error: float
    bound: float
    condition: float | None = None
    unit: str = "1"
    note: str = ""


@dataclass(frozen=True, slots=True)
class HardCase:
    """A case that is hard for numbers: what makes it hard, for an engineer, and what it is held against.

    Parameters
    ----------
    run : gives the answer, or raises the refusal.
    refuses : the error that is the right end of this case; None where an answer is.
    """

    name: str
    area: str
    hard: str
    truth: str
    run: Callable[[], Answer | None]
    refuses: type[CbsrError] | None = None


_Answers: TypeAlias = Callable[[], Answer]
_Refused: TypeAlias = Callable[[], None]
_Run = TypeVar("_Run", _Answers, _Refused)


class Area:
    """Cases that belong together, in the order their functions are defined.

    A case has the name of its function, with hyphens. The docstring says what makes it hard.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.cases: list[HardCase] = []

    def against(self, truth: str) -> Callable[[_Answers], _Answers]:
        """Add a case whose answer is compared with a truth."""
        return lambda run: self._added(run, truth, None)

    def refused(self, error: type[CbsrError], truth: str = "refusal") -> Callable[[_Refused], _Refused]:
        """Add a case whose right end is an error."""
        return lambda run: self._added(run, truth, error)

    def _added(self, run: _Run, truth: str, refuses: type[CbsrError] | None) -> _Run:
        hard = " ".join((inspect.getdoc(run) or "").split())
        self.cases.append(HardCase(run.__name__.replace("_", "-"), self.name, hard, truth, run, refuses))
        return run


@dataclass(frozen=True, slots=True)
class CaseResult:
    """How a hard case came out.

    Parameters
    ----------
    outcome : within its bound, refused as it should be, or broken.
    error, bound, unit, condition, note : of the answer; None where it was refused or failed, or is no finite number.
    reason : of the refusal, or why it is broken; None where it is in its bound.
    remedy : what the user can do; None where there is no advice.
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


def conditioned_bound(condition: float, floor: float = 0.0) -> float:
    """Bound of a relative error from a condition number: 100 times it times machine precision, at least a floor."""
    return max(floor, CONDITIONING_ROOM * condition * EPSILON)


def conditioned(error: float, condition: float, *, unit: str = "1", note: str = "") -> Answer:
    """Answer whose error may be what its condition number makes of rounding."""
    return Answer(error, conditioned_bound(condition), condition, unit, note)


def examine(case: HardCase, *, longest_s: float = LONGEST_S) -> CaseResult:
    """Run a case; a warning of numpy or scipy, or no end within a time, counts as an unexplained answer."""
    started_s = perf_counter()
    try:
        with warnings.catch_warnings(), _within(longest_s):
            warnings.simplefilter("error")
            answer = case.run()
    except CbsrError as refusal:
        expected = case.refuses is not None and isinstance(refusal, case.refuses)
        outcome = Ending.REFUSED if expected and refusal.reason else Ending.BROKEN
        reason = refusal.reason if expected else f"refused without need: {refusal.reason}"
        return _result(case, outcome, started_s, reason=reason, remedy=refusal.remedy)
    except Exception as error:  # noqa: BLE001  # whatever it is: a broken case is shown, not the end of the table
        return _result(case, Ending.BROKEN, started_s, reason=f"{type(error).__name__}: {error}")
    reason = _why_broken(case, answer)
    return _result(case, Ending.BROKEN if reason else Ending.OK, started_s, answer, reason)


@contextmanager
def _within(seconds: float) -> Iterator[None]:
    """Raise TimeoutError after some seconds, where the system has timers and this is the thread they interrupt."""
    if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"no end within {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _why_broken(case: HardCase, answer: Answer | None) -> str:
    """Say why an answer breaks its case; empty where it is within its bound."""
    if case.refuses is not None:
        return f"a number where {case.refuses.__name__} was to be raised"
    assert answer is not None  # of a case that answers
    if not (math.isfinite(answer.error) and math.isfinite(answer.bound)):
        return "its error or its bound is no finite number"
    within = 0 <= answer.error <= answer.bound
    return "" if within else f"an error of {answer.error:.3g} where {answer.bound:.3g} is allowed"


def _result(
    case: HardCase,
    outcome: Ending,
    started_s: float,
    answer: Answer | None = None,
    reason: str = "",
    remedy: str = "",
) -> CaseResult:
    given = answer or Answer(math.nan, math.nan)
    return CaseResult(
        name=case.name,
        area=case.area,
        hard=case.hard,
        truth=case.truth,
        outcome=outcome,
        error=_finite(given.error),
        bound=_finite(given.bound),
        unit=given.unit if answer else None,
        condition=_finite(given.condition),
        reason=reason or None,
        remedy=remedy or None,
        note=given.note or None,
        seconds=round(perf_counter() - started_s, 3),
    )


def _finite(value: float | None) -> float | None:
    """Return a finite number, or None: JSON has no NaN."""
    return float(value) if value is not None and math.isfinite(value) else None
