"""Asks whoever sits at the terminal."""

import sys
from collections.abc import Callable
from typing import Final

from cbsr_qa.domain.errors import AbortedError

#: Answers that end the run instead of being handed on.
STOP: Final = ("stop", "abort")


def operator_at_terminal() -> Callable[[str], str] | None:
    """Return what asks the operator; None where no terminal is at the input."""
    return asked if sys.stdin is not None and sys.stdin.isatty() else None


def asked(text: str) -> str:
    """Show a text on stderr, so that ``--json`` prints one document only, and return the line that is typed.

    Raises
    ------
    AbortedError
        If the answer is "stop" or "abort", or the input has ended.
    """
    sys.stderr.write(f"\n{text}\n('stop' ends the run) > ")
    sys.stderr.flush()
    line = sys.stdin.readline()
    if not line:
        raise AbortedError("the operator, who closed the terminal's input")
    if line.strip().lower() in STOP:
        raise AbortedError(f"the operator, who answered {line.strip()!r}")
    return line.strip()
