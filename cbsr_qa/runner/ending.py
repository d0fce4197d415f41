"""How a run ended, in words: by whom it was stopped, or which rule, instrument or error broke it, and where."""

import logging
from contextlib import suppress
from typing import Final

from cbsr_qa.domain.contained import said
from cbsr_qa.domain.errors import AbortedError, CbsrError, InstrumentError, SafetyError
from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.runner.interrupts import Stopped
from cbsr_qa.runner.watchdog import BrokenInto

#: Reason and detail.
Ending = tuple[EndReason, str]

_log: Final = logging.getLogger(__name__)


def ending(error: BaseException, where: str, *, at_once: bool = False, before: Ending | None = None) -> Ending:
    """Say how an error ended a run.

    Parameters
    ----------
    where : "while", the step under way, and what the bench was doing.
    at_once : a second signal ended it.
    before : how the run had ended already when this came up while the head was lifted.
    """
    with suppress(Exception):
        _log.debug("the run ended while %s", where, exc_info=error)
    if before is not None:
        reason, detail = before
        return reason, f"{detail}; {_during_retreat(error)}"
    if isinstance(error, AbortedError | KeyboardInterrupt):
        how = " and at once by a second signal" if at_once else ""
        return EndReason.ABORTED, f"by {_by(error)}{how}, {where}"
    return EndReason.BROKEN, f"{_what(error)}, {where}{_remedy(error)}"


def unsafe(end: Ending, silent: tuple[str, ...]) -> Ending:
    """Say that instruments did not reach their safe state: whatever else it was, the run is broken."""
    said = [f"NOT SAFE: {who}; look at the bench before touching it" for who in silent]
    return EndReason.BROKEN, "; ".join([*filter(None, [_told(end)]), *said])


def _told(end: Ending) -> str:
    reason, detail = end
    return f"aborted {detail}" if reason is EndReason.ABORTED else detail


def _by(error: BaseException) -> str:
    return error.by if isinstance(error, AbortedError | Stopped) else "the operator (Ctrl-C)"


def _what(error: BaseException) -> str:
    match error:
        case BrokenInto():
            return _what(error.error)
        case SafetyError():
            return f"rule {error.rule!r}: {error.reason}"
        case InstrumentError():
            return f"instrument {error.reason}"
        case CbsrError():
            return error.reason
        case _:
            return f"error {said(error)}"


def _remedy(error: BaseException) -> str:
    """What to do about it, where the error says so."""
    cause = error.error if isinstance(error, BrokenInto) else error
    remedy = cause.remedy if isinstance(cause, CbsrError) else ""
    return f"; {remedy}" if remedy else ""


def _during_retreat(error: BaseException) -> str:
    if isinstance(error, AbortedError | KeyboardInterrupt):
        return "a second signal ended it at once"
    return f"the head was not lifted in order: {_what(error)}"
