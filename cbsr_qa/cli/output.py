"""The terminal: one JSON document or text on stdout; messages, progress and questions on stderr."""

import json
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self, TextIO

from cbsr_qa.domain.errors import AbortedError

if TYPE_CHECKING:
    from cbsr_qa.domain.results.report import CommandOutcome


def emit_json(document: Mapping[str, Any]) -> None:
    """Print one document on stdout. ValueError if a number in it is NaN or infinite."""
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    if _escape_unprintable(text) != text:
        text = json.dumps(document, indent=2, allow_nan=False)
    _print(text)


def check_page(output: Path | None) -> None:
    """Refuse a page that would replace something else; see :func:`cbsr_qa.report.render.check_replaceable`."""
    if output is not None:
        from cbsr_qa.report.render import check_replaceable

        check_replaceable(output)


def show(outcome: "CommandOutcome[Any]", *, output: Path | None = None, as_json: bool = False) -> int:
    """Print a command's outcome, write its page if ``output`` is given, and return its exit code."""
    if output is not None:
        from cbsr_qa.report.render import render_sections, write_report

        write_report(output, render_sections(outcome.page, outcome.sections))
        note(f"page         {output}")
    if as_json:
        from cbsr_qa.report.document import json_document

        emit_json(json_document(outcome.result))
        return outcome.exit_code
    from cbsr_qa.report.terminal import terminal_lines

    # Whether stdout is a terminal that shows colours, and nobody has asked for none (https://no-color.org).
    coloured = any(_on_terminal) and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
    paint = _COLOURS.get(outcome.page.banner.tone, "") if coloured else ""
    for line in terminal_lines(outcome.page, outcome.sections):
        say(f"{paint}{line}{_PLAIN}" if paint else line)
        paint = ""
    return outcome.exit_code


#: Colours of the first line of a verdict, by the tone of its banner; the line has the word in any case.
_COLOURS: Final = {"pass": "\x1b[1;32m", "marginal": "\x1b[1;33m", "fail": "\x1b[1;31m", "not-measured": "\x1b[1;35m"}
_PLAIN: Final = "\x1b[0m"


def say(text: str = "") -> None:
    """Print text on stdout; for commands without ``--json``."""
    _print(text)


def note(text: str) -> None:
    """Print a message on stderr; errors are ignored."""
    if sys.stderr is not None:
        with suppress(OSError, ValueError):
            sys.stderr.write(text + "\n")
            sys.stderr.flush()


def announce(stage: str) -> None:
    """Print the current stage on stderr."""
    note(f"{stage} …")


def take_lost_output() -> str:
    """Return why output on stdout was lost, and reset it; empty if it was not, or its reader (``head``) has ended."""
    reason = "; ".join(_lost)
    _lost.clear()
    return reason


def reader_has_gone() -> bool:
    """Whether stdout is a pipe without a reader, with output left in its buffer."""
    stream = _stream()
    if stream is None:
        return False
    try:
        stream.flush()
    except BrokenPipeError:
        _discard_the_rest(stream)
        return True
    return False


def claim_stdout(stream: TextIO | None = None) -> None:
    """Keep stdout for :func:`emit_json` and :func:`say`; redirect all other output of this process to stderr.

    This includes C code and subprocesses. Does nothing if ``sys.stdout`` was replaced (by a test), or is None.

    Parameters
    ----------
    stream : stream that both write to instead of stdout; None for stdout itself.
    """
    global _claimed
    stdout, stderr = sys.__stdout__, sys.__stderr__
    if stdout is None or sys.stdout is not stdout:
        return
    stdout.flush()
    _on_terminal[:] = [stdout.isatty()]
    descriptor = stdout.fileno()
    if stream is None:
        stream = os.fdopen(os.dup(descriptor), "w", encoding=stdout.encoding, errors=stdout.errors)
    os.dup2(os.open(os.devnull, os.O_WRONLY) if stderr is None else stderr.fileno(), descriptor)
    sys.stdout, _claimed = sys.stderr, stream


def live_output() -> Callable[[bytes], None] | None:
    """Return a function that writes to stdout past all buffers, and raises OSError if nobody reads; None without."""
    stream = _stream()
    if stream is None:
        return None
    stream.flush()
    number = stream.fileno()

    def write(data: bytes) -> None:
        remaining = memoryview(data)
        while remaining:
            remaining = remaining[os.write(number, remaining) :]

    return write


def _stream() -> TextIO | None:
    return sys.stdout if _claimed is None else _claimed


#: The original stdout.
_claimed: TextIO | None = None

#: Whether stdout is a terminal; a child process hands its output to its parent, who prints it there.
_on_terminal: Final[list[bool]] = []

#: Reasons why output was lost; a command continues without a reader, and its exit code reports its result.
_lost: list[str] = []


def _print(text: str) -> None:
    stream = _stream()
    if stream is None:  # closed by the caller, who wants no output
        return
    try:
        stream.write(_escape_unprintable(text) + "\n")
        stream.flush()
    except BrokenPipeError:
        _discard_the_rest(stream)
    except OSError as error:
        _lost.append(error.strerror or str(error))
        _discard_the_rest(stream)


def _escape_unprintable(text: str) -> str:
    """Escape the characters that stdout cannot encode, as stderr does."""
    encoding = getattr(_stream(), "encoding", None) or "utf-8"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def _discard_the_rest(stream: TextIO) -> None:
    """Discard the buffer and further output: the interpreter would fail to flush it at exit."""
    with suppress(OSError, ValueError):
        null_device = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null_device, stream.fileno())
        os.close(null_device)


#: Longest line with a PIN [characters]; a longer one is no PIN.
_LONGEST_PIN_LINE: Final = 1000

#: Answers that end the run instead of being passed on.
STOP: Final = ("stop", "abort")


def operator_is_there() -> bool:
    """Whether stdin is a terminal, at which an operator can answer."""
    return sys.stdin is not None and sys.stdin.isatty()


def ask_operator(text: str) -> str:
    """Show a text on stderr and return the answer.

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


def read_pin(text: str) -> str:
    """Return what is typed at the terminal without showing it, or the first line of stdin if that is no terminal.

    Empty where the input has ended.
    """
    if sys.stdin is None:
        return ""
    if not sys.stdin.isatty():
        return sys.stdin.readline(_LONGEST_PIN_LINE).rstrip("\r\n")
    from getpass import getpass

    try:
        return getpass(f"{text}: ", stream=sys.stderr)
    except EOFError:
        return ""


class Counting:
    """Context manager that shows stages, and the progress of one: a bar on a terminal, else a line per stage.

    Parameters
    ----------
    what : name of the counted things, e.g. ``"frames"``.
    stream : stream of the output; by default the process's stderr.
    """

    def __init__(self, what: str, *, stream: TextIO | None = None) -> None:
        self._what = what
        self._stream = stream or sys.stderr
        self._bar: _Bar | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def stage(self, name: str) -> None:
        self._close()
        print(f"{name} …", file=self._stream, flush=True)

    def count(self, done: int, of: int) -> None:
        """Show the progress of the stage."""
        if self._bar is None and self._stream.isatty():
            self._bar = _Bar(self._what, self._stream)
        if self._bar is not None:
            self._bar.show(done, of)

    def _close(self) -> None:
        if self._bar is not None:
            bar, self._bar = self._bar, None
            with suppress(OSError):  # the terminal may be gone before the work is done
                bar.close()


class _Bar:
    """The bar on a terminal; rich is imported only for it."""

    def __init__(self, what: str, stream: TextIO) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (BarColumn(bar_width=24), MofNCompleteColumn(), TextColumn(what), TimeRemainingColumn())
        self._bar = Progress(*columns, console=Console(file=stream), transient=True)
        self._task = self._bar.add_task(what, total=None)
        self._bar.start()

    def show(self, done: int, of: int) -> None:
        self._bar.update(self._task, completed=done, total=of)

    def close(self) -> None:
        self._bar.stop()
