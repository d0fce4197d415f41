"""A numerically hard case: what makes it hard, what it is held against, and how it came out."""

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
from typing import Final

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
    REFUSED = "refused"  #: refused by name, as it should be
    BROKEN = "broken"  #: out of its bound, not finite, an unexplained error or warning, or a refusal not asked for


@dataclass(frozen=True, slots=True)
class Answer:
    """What a hard case gave.

    Parameters
    ----------
    error : against truth, not negative; relative where nothing else is said.
    bound : it may have.
    condition : number of what was solved; None where nothing is solved.
    unit : of error and bound; ``"1"`` for relative ones.
    note : what an engineer should know of the number; may be empty.
    """

    error: float
    bound: float
    condition: float | None = None
    unit: str = "1"
    note: str = ""


@dataclass(frozen=True, slots=True)
class HardCase:
    """A case that is hard for numbers.

    Parameters
    ----------
    name : of the case, words joined by hyphens, unique.
    area : what it belongs to: ``"forward model"``, ``"readings"``, ``"reconstruction"``, ``"imaging"``,
        ``"relaxation"``, ``"calibration"``, ``"time"`` or ``"statistics"``.
    hard : what makes it hard, in a sentence for an engineer who has not read the paper.
    truth : what it is held against.
    run : gives the answer, or raises the refusal.
    refuses : the error that is the right end of this case; None where a number is.
    """

    name: str
    area: str
    hard: str
    truth: str
    run: Callable[[], Answer]
    refuses: type[CbsrError] | None = None


@dataclass(frozen=True, slots=True)
class CaseResult:
    """How a hard case came out.

    Parameters
    ----------
    case : that was examined.
    outcome : within its bound, refused as it should be, or broken.
    answer : the number; None where it was refused or failed.
    reason : of the refusal, or why it is broken; empty where it is in its bound.
    remedy : what the user is told to do.
    seconds : it took.
    """

    case: HardCase
    outcome: Ending
    answer: Answer | None
    reason: str
    remedy: str
    seconds: float


def conditioned_bound(condition: float, floor: float = 0.0) -> float:
    """Bound of a relative error from a condition number: 100 times it times machine precision, at least a floor."""
    return max(floor, CONDITIONING_ROOM * condition * EPSILON)


def examine(case: HardCase, *, longest_s: float = LONGEST_S) -> CaseResult:
    """Run a case; a warning of numpy or scipy, or no end within a time, counts as an unexplained answer."""
    started_s = perf_counter()
    try:
        with warnings.catch_warnings(), _within(longest_s):
            warnings.simplefilter("error")
            answer = case.run()
    except CbsrError as refusal:
        return _refused(case, refusal, perf_counter() - started_s)
    except Exception as error:  # noqa: BLE001  # whatever it is: a broken case is shown, not the end of the table
        seconds = perf_counter() - started_s
        return CaseResult(case, Ending.BROKEN, None, f"{type(error).__name__}: {error}", "", seconds)
    return _answered(case, answer, perf_counter() - started_s)


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


def _refused(case: HardCase, refusal: CbsrError, seconds: float) -> CaseResult:
    expected = case.refuses is not None and isinstance(refusal, case.refuses)
    outcome = Ending.REFUSED if expected and refusal.reason else Ending.BROKEN
    reason = refusal.reason if expected else f"refused without need: {refusal.reason}"
    return CaseResult(case, outcome, None, reason, refusal.remedy, seconds)


def _answered(case: HardCase, answer: Answer, seconds: float) -> CaseResult:
    if case.refuses is not None:
        reason = f"a number where {case.refuses.__name__} was to be raised"
        return CaseResult(case, Ending.BROKEN, answer, reason, "", seconds)
    finite = math.isfinite(answer.error) and math.isfinite(answer.bound)
    within = finite and 0 <= answer.error <= answer.bound
    said = f"an error of {answer.error:.3g} where {answer.bound:.3g} is allowed"
    reason = "" if within else said if finite else "its error or its bound is no finite number"
    return CaseResult(case, Ending.OK if within else Ending.BROKEN, answer, reason, "", seconds)
