"""Errors shown to users. Each has a reason, a remedy and an exit code."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

#: Beginning of a line of a remedy that only helps at the command line.
AT_COMMAND_LINE: Final = "at the command line: "
#: Last commit of cbsr-qa that reads and exports databases and calibration files from before 0.1.0.
LAST_UNRELEASED: Final = "2ab34542"
#: Longest description of a row, in characters.
LONGEST_PROBLEM: Final = 300


@dataclass(frozen=True, slots=True)
class RowProblem:
    """A row that was excluded, or used with reservations.

    Parameters
    ----------
    line : 1-based line of the file.
    what : the problem in words, with what was found; cut after :data:`LONGEST_PROBLEM` characters.
    rejected : whether the row's numbers were left out (a log line inside a frame is not a rejected row).
    """

    line: int
    what: str
    rejected: bool

    def __post_init__(self) -> None:
        """Cut parts that a file may have made long: a line of megabytes is not a message."""
        if len(self.what) > LONGEST_PROBLEM:
            object.__setattr__(self, "what", f"{self.what[:LONGEST_PROBLEM]}… ({len(self.what)} characters)")


def drop_command_lines(words: str) -> str:
    """Return a remedy without its lines that only help at the command line."""
    return "\n".join(line for line in words.splitlines() if not line.startswith(AT_COMMAND_LINE))


class CbsrError(Exception):
    """Base class of all errors that this package raises deliberately.

    Parameters
    ----------
    reason : what was found, naming the file, key, row or role.
    remedy : what the reader can do about it; may be empty. Commands and options that do it are a line of their own,
        which begins with :data:`AT_COMMAND_LINE`: a page has buttons instead.
    """

    exit_code: ClassVar[int] = 2
    #: Key of the document that ``--json`` prints (empty: none), and the attributes it holds.
    heading: ClassVar[str] = "refused"
    stated: ClassVar[tuple[str, ...]] = ("reason", "remedy")

    def __init__(self, reason: str, *, remedy: str = "") -> None:
        super().__init__(f"{reason}\n{remedy}" if remedy else reason)
        self.reason = reason
        self.remedy = remedy

    def _render_traceback_(self) -> list[str]:
        """Return what IPython shows in place of a traceback: the reason would stand below fifty lines of code."""
        return f"{type(self).__name__}: {self}".splitlines()

    def document(self) -> dict[str, Any]:
        """Return the document that ``--json`` prints."""
        stated = {name: getattr(self, name) for name in self.stated}
        return {self.heading: stated} if self.heading else stated


class RefusedError(CbsrError):
    """Unusable input: nothing was done or written (exit code 2)."""


class ConfigError(RefusedError):
    """A configuration file is missing, malformed or has a value that is not allowed."""


class PluginError(RefusedError):
    """A requested plugin is unknown or cannot be loaded."""


class RecordingError(RefusedError):
    """A recording has no usable data, or violates its format.

    Parameters
    ----------
    problems : rows rejected or noted before reading stopped.
    """

    def __init__(self, reason: str, *, remedy: str = "", problems: Sequence[RowProblem] = ()) -> None:
        super().__init__(reason, remedy=remedy)
        self.problems = tuple(problems)


class StoreError(RefusedError):
    """The database is missing, damaged, of another version, or lacks the requested data."""


class CalibrationError(RefusedError):
    """A calibration file is damaged, edited, of another version, or does not match its use."""


class NumericsError(RefusedError):
    """A computation was refused (rank, range, shape) instead of returning an image of noise."""


class InstrumentError(CbsrError):
    """An instrument did not execute a command (exit code 3).

    Parameters
    ----------
    role : the instrument's role in the station file, e.g. ``"load_cell"``.
    address : address where it was expected.
    retryable : whether the request may be repeated (after a lost reply, not a broken rule).
    """

    exit_code = 3

    def __init__(self, role: str, address: str, reason: str, *, remedy: str = "", retryable: bool = False) -> None:
        super().__init__(f"{role} at {address}: {reason}", remedy=remedy)
        self.role = role
        self.address = address
        self.retryable = retryable


class NoMoreFramesError(InstrumentError):
    """A frame source has delivered all the frames it had: a recording is over. Not a fault of an instrument."""


class DeliveryError(CbsrError):
    """Events were not delivered; they are sent again unless ``final``: the receiver would never take them."""

    def __init__(self, reason: str, *, remedy: str = "", final: bool = False) -> None:
        super().__init__(reason, remedy=remedy)
        self.final = final


class SafetyError(CbsrError):
    """A safety rule was violated; the bench is in its safe state (exit code 3)."""

    exit_code = 3

    def __init__(self, rule: str, reason: str, *, remedy: str = "") -> None:
        super().__init__(reason, remedy=remedy)
        self.rule = rule


class BrokenRunError(CbsrError):
    """A run had begun and could not be completed; its stored data stay (exit code 3).

    Its document is that of the run, as far as it exists.
    """

    exit_code = 3
    heading = ""
    stated = ("run", "end", "outcome", "reason", "remedy", "report", "calibration", "measurements")
    end: ClassVar[str] = "broken"
    outcome: ClassVar[str] = "not measured"
    report: ClassVar[None] = None
    calibration: ClassVar[None] = None
    measurements: ClassVar[tuple[()]] = ()

    def __init__(self, run: str, reason: str, *, remedy: str = "") -> None:
        prefix = f"run {run}: "  # which refusals of the database have already
        super().__init__(prefix + reason.removeprefix(prefix), remedy=remedy)
        self.run = run


class BrokenError(CbsrError):
    """The program, or a process of it, failed outside of a run (exit code 3)."""

    exit_code = 3
    heading = "broken"


class NotReproducedError(BrokenError):
    """A simulated sensor of a reproduction has no values: its run stopped, or has no analysis (exit code 3)."""


class StoppedError(CbsrError):
    """A command was stopped outside of a run (exit code 3)."""

    exit_code = 3
    heading = "aborted"


class UnconcludedError(StoppedError):
    """Measuring was complete, and the program was stopped before the result was written (exit code 3).

    Parameters
    ----------
    again : command that computes the result from what is stored; nothing moves if the run had finished.
    by : person or thing that stopped it.
    """

    stated = ("run", "reason", "remedy")

    def __init__(self, run: str, again: str, by: str) -> None:
        super().__init__(
            f"run {run}: stopped by {by} while computing its result; all measured data is stored",
            remedy=f"to continue: {again}",
        )
        self.run = run


class AbortedError(CbsrError):
    """The run was stopped by an operator or a signal; the bench is in its safe state (exit code 3)."""

    exit_code = 3

    def __init__(self, by: str) -> None:
        super().__init__(f"aborted by {by}")
        self.by = by
