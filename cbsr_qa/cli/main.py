"""The command ``cbsr-qa``: its commands, and errors as messages and exit codes."""

import gc
import os
import re
import sys
import traceback
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, cast

import typer

import cbsr_qa
from cbsr_qa.cli.command import Command, PlainCommand, PlainGroup, commands, purpose
from cbsr_qa.cli.output import claim_stdout, emit_json, note, reader_has_gone, take_lost_output
from cbsr_qa.cli.supervised import end_child, supervise
from cbsr_qa.domain.errors import BrokenError, CbsrError, RefusedError, StoppedError
from cbsr_qa.system.redelivery import Redelivery
from cbsr_qa.system.words import describe_error

app = typer.Typer(
    name="cbsr-qa",
    cls=PlainGroup,
    help="Test, judge and calibrate soft pressure sensors read by electrical impedance tomography.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

#: Whether a document was requested, after parsing: "--json" may be another option's value.
_asked_for_json: list[bool] = []

#: Whether commands run in a child process: only if this process ends with the command.
_supervising = False


def _supervise_command(command: Command) -> Callable[..., Any]:
    """Run a command in a child process, with stdout kept for its document; help needs neither."""

    @wraps(command.run)
    def run_command(*arguments: Any, **options: Any) -> Any:
        _asked_for_json.append(bool(options.get("as_json")))
        judges = command.words == "run" and not options["dry_run"]
        # Click parses the command line here, before any plugin code runs.
        if _supervising and (code := supervise(judges=judges, live=command.live, reads=command.reads)) is not None:
            return code
        claim_stdout()
        with Redelivery():  # of the process that carries out the command: the child
            return command.run(*arguments, **options)

    return run_command


def _add_commands(root: typer.Typer, typed: list[str]) -> None:
    groups: dict[str, typer.Typer] = {"": root}
    for command in commands(typed[0] if typed else ""):
        if command.group not in groups:
            groups[command.group] = typer.Typer(cls=PlainGroup, help=purpose(command.group), no_args_is_help=True)
            root.add_typer(groups[command.group], name=command.group, rich_help_panel=command.panel)
        panel = None if command.group else command.panel
        add = groups[command.group].command(
            command.words.split()[-1], cls=PlainCommand, help=command.purpose, rich_help_panel=panel
        )
        add(_supervise_command(command))


if sys.argv[1:] != ["--version"]:  # that needs no command, and they are a third of its time
    _add_commands(app, sys.argv[1:])


def _version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"cbsr-qa {cbsr_qa.__version__}\n")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Test, judge and calibrate soft pressure sensors read by electrical impedance tomography."""


_REPORT_IT = "stored data are kept; please report this with the output of CBSR_QA_TRACEBACK=1 and the command"

_LOST = "free some space, or name another file; stored data are kept: cbsr-qa db status, cbsr-qa report RUN"

#: Errors of typer for a misused command line. It has its own copy of click, or uses the installed one.
_UsageError = cast(type[Exception], typer.BadParameter.__mro__[1])

#: Result of typer after Ctrl-C when it does not end the program.
_INTERRUPTED = 130

#: Environment variables from which numerical libraries take their number of threads when they are loaded.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


#: Factor by which garbage collection is rarer than by default: loading libraries and reading a fleet create millions
#: of objects and hardly a cycle, and searching took a third of the time of ``compare``. Nothing is searched while the
#: libraries of a run are loaded.
COLLECTED = (500_000, 20, 20)


def entry() -> None:
    """Run the command line: exit code 0 passed or done, 1 failed, 2 refused, 3 aborted, broken or not measured.

    Numerical libraries use one thread: with more, last digits depend on the number of cores, and matrices of this
    size are slower.
    """
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    gc.set_threshold(*COLLECTED)
    sys.exit(run_and_supervise(sys.argv[1:]))


def run_and_supervise(arguments: list[str]) -> int:
    """Run one command in a child process, as the installed program does; return its exit code."""
    global _supervising
    _supervising, code = hasattr(os, "fork"), 3
    try:
        code = run_guarded(arguments)
    finally:
        end_child(code)
    return code


def run_guarded(arguments: list[str]) -> int:
    """Run one command and return its exit code; every error becomes one message.

    Output that could not be written (a full disk) gives exit code 3, unless the command was refused. A reader that
    has gone does not change the exit code.
    """
    code, lost_reason = _run_typer(arguments), take_lost_output()
    if not lost_reason:
        return code
    note(f"cbsr-qa: the output could not be written: {lost_reason}\n{_LOST}")
    return 3 if code < 2 else code


def _wants_json(arguments: list[str]) -> bool:
    return any(_asked_for_json or ["--json" in arguments])


def _run_typer(arguments: list[str]) -> int:
    _asked_for_json.clear()
    try:
        result: object = app(arguments, prog_name="cbsr-qa", standalone_mode=False)
        if result == _INTERRUPTED:
            raise KeyboardInterrupt
    except CbsrError as error:
        return _report_error(error, arguments)
    except _UsageError as error:
        return _report_misuse(error, arguments)
    except (typer.Abort, KeyboardInterrupt):
        # Commands other than a run, which handles this itself.
        return _report_error(StoppedError("stopped from the keyboard", remedy="start it again"), arguments, "aborted")
    except BaseException as error:  # noqa: BLE001 - exit code 1 means that a sensor failed, and nothing else
        code = _read_exit_code(error)
        return _report_defect(error, arguments) if code is None else code
    return result if isinstance(result, int) else 0


def _read_exit_code(error: BaseException) -> int | None:
    """Exit code if no command has begun: completion, or help piped into a program that has ended (not an instrument).

    For such help, Rich raises SystemExit, with stdout redirected to nowhere.
    """
    if isinstance(error, SystemExit) and not _asked_for_json:
        return 2 if error.code and not isinstance(error.__context__, BrokenPipeError) else 0
    return 0 if isinstance(error, BrokenPipeError) and reader_has_gone() else None


def _report_error(error: CbsrError, arguments: list[str], words: str = "") -> int:
    """Print an error, also as a document if requested, and return its exit code."""
    if _wants_json(arguments):
        emit_json(error.document())
    note(f"cbsr-qa: {words or error}")
    return error.exit_code


def _report_defect(error: BaseException, arguments: list[str]) -> int:
    """Report an internal error and its place; exit code 3: nothing was decided."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    reason = f"internal error: {describe_error(error)} ({Path(frame.filename).name}, line {frame.lineno})"
    code = _report_error(BrokenError(reason, remedy=_REPORT_IT), arguments)
    if os.environ.get("CBSR_QA_TRACEBACK"):
        traceback.print_exception(error)
    return code


#: Wording of pydantic and click → wording for engineers.
_WORDS = {
    r"Input should be a valid integer.*": "it must be a whole number",
    r"Input should be a valid number.*": "it must be a number",
    r"Input should be greater than or equal to (.*)": r"it must be at least \1",
    r"Input should be less than or equal to (.*)": r"it must be at most \1",
    r"Option '--place' requires 2 arguments\.": "--place needs two numbers, x and y in mm, e.g. --place 10 -5",
    r"(?:Value error, )?('.*') does not match the formats? '%Y-%m-%d'\.?": r"\1 is not a date like 2027-03-31",
}


def _report_misuse(error: Any, arguments: list[str]) -> int:
    """Report what is wrong with the command line."""
    if not error.format_message():
        return 2  # a command without any argument: typer has printed its help
    for jargon, wording in _WORDS.items():
        if re.fullmatch(jargon, error.message):
            error.message = re.sub(jargon, wording, error.message)
            break
    if _wants_json(arguments):
        emit_json(RefusedError(error.format_message(), remedy="see cbsr-qa COMMAND --help").document())
    error.show()
    return 2
