"""The command ``cbsr-qa``: puts the command groups together, and turns errors into messages and exit codes."""

import sys
from typing import Annotated

import click
import typer

import cbsr_qa
from cbsr_qa.cli import analyse, calibration, db, export, plugins, report, run
from cbsr_qa.cli.output import emit_json, note, refusal
from cbsr_qa.domain.errors import CbsrError

app = typer.Typer(
    name="cbsr-qa",
    help="Test, judge and calibrate soft pressure sensors read by electrical impedance tomography.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("run")(run.run)
app.command("analyse")(analyse.analyse)
app.command("report")(report.report)
app.command("export")(export.export)
app.add_typer(calibration.app, name="calibration")
app.add_typer(plugins.app, name="plugins")
app.add_typer(db.app, name="db")


def _version(asked: bool) -> None:
    if asked:
        sys.stdout.write(f"cbsr-qa {cbsr_qa.__version__}\n")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Test, judge and calibrate soft pressure sensors read by electrical impedance tomography."""


def entry() -> None:
    """Run the command line: exit code 0 passed or done, 1 failed, 2 refused, 3 aborted, broken or not measured."""
    sys.exit(guarded(sys.argv[1:]))


def guarded(arguments: list[str]) -> int:
    """Run one command and return its exit code; every expected error becomes one clear message."""
    try:
        result = app(arguments, standalone_mode=False)
    except CbsrError as error:
        if "--json" in arguments:
            emit_json(refusal(error))
        note(f"cbsr-qa: {error}")
        return error.exit_code
    except click.ClickException as error:
        error.show(sys.stderr)
        if "--json" in arguments:
            emit_json({"refused": {"reason": error.format_message(), "remedy": "see cbsr-qa --help"}})
        return 2
    except (click.Abort, KeyboardInterrupt):
        note("cbsr-qa: aborted")
        return 3
    except BrokenPipeError:
        # Whoever read our output has gone (head, a pager): not an error of ours.
        sys.stderr.close()
        return 0
    return result if isinstance(result, int) else 0
