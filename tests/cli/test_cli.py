"""Errors at the command line: one message, the right exit code, one document."""

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from cbsr_qa.cli import main
from cbsr_qa.domain.errors import AbortedError, ConfigError, InstrumentError


def _raising(error):
    def app(arguments, **options):
        raise error

    return app


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ConfigError("no such key", remedy="use another"), 2),
        (InstrumentError("load_cell", "COM3", "does not answer"), 3),
        (AbortedError("the operator"), 3),
        (KeyboardInterrupt(), 3),
        (ZeroDivisionError("division by zero"), 3),
    ],
)
def test_an_error_never_looks_like_a_failed_sensor(monkeypatch, capsys, error, code):
    monkeypatch.setattr(main, "app", _raising(error))
    assert main.run_guarded(["run"]) == code
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("cbsr-qa: ")
    assert "Traceback" not in said.err


def test_with_json_a_refusal_and_an_internal_error_are_documents(monkeypatch, capsys):
    monkeypatch.setattr(main, "app", _raising(ConfigError("no such key", remedy="use another")))
    main.run_guarded(["run", "--json"])
    assert json.loads(capsys.readouterr().out) == {"refused": {"reason": "no such key", "remedy": "use another"}}
    monkeypatch.setattr(main, "app", _raising(ZeroDivisionError("division by zero")))
    main.run_guarded(["run", "--json"])
    assert "ZeroDivisionError: division by zero" in json.loads(capsys.readouterr().out)["broken"]["reason"]


def test_a_traceback_can_be_asked_for(monkeypatch, capsys):
    monkeypatch.setattr(main, "app", _raising(ZeroDivisionError("division by zero")))
    monkeypatch.setenv("CBSR_QA_TRACEBACK", "1")
    main.run_guarded(["run"])
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[], ["run"], ["run", "--nonsense"], ["nonsense"], ["calibration"]])
def test_a_misused_command_line_ends_with_2_and_says_so_on_stderr(capsys, arguments):
    assert main.run_guarded(arguments) == 2
    said = capsys.readouterr()
    # Help that nobody asked for by --help is shown by typer itself where it likes; a mistake goes to stderr.
    assert said.err.strip() or "Usage" in said.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "--seed", "abc"], "'--seed': it must be a whole number"),
        (["scene", "run", "none", "--seed", "-4"], "'--seed': it must be at least 0"),
        (["scene", "run", "none", "--seed", "9999999999"], "'--seed': it must be at most 2147483647"),
        (["run", "--seed", "-3"], "'--seed': it must be at least 0"),
        (["calibration", "apply", "a.h5", "b.h5", "--place", "3"], "--place needs two numbers, x and y in mm"),
        (["gauge", "--confidence", "high"], "'--confidence': it must be a number"),
        (["gauge", "--since", "2026-13-01"], "'--since': '2026-13-01' is not a date like 2027-03-31"),
    ],
)
def test_a_value_that_an_option_cannot_take_is_refused_in_words(capsys, arguments, said):
    assert main.run_guarded(arguments) == 2
    assert said in " ".join(capsys.readouterr().err.replace("│", " ").split())


@pytest.mark.parametrize("command", ["run", "analyse", "report", "export", "scene", "calibration", "plugins", "db"])
def test_every_command_has_help(capsys, command):
    assert main.run_guarded([command, "--help"]) == 0
    assert "Usage" in capsys.readouterr().out


@pytest.mark.parametrize("as_json", [False, True])
def test_ctrl_c_in_any_command_is_said(monkeypatch, capsys, as_json):
    """typer makes an exit code of it, without a word."""
    monkeypatch.setattr(main, "app", lambda *_, **__: 130)
    assert main.run_guarded(["analyse", "x.csv", *["--json"] * as_json]) == 3
    out, err = capsys.readouterr()
    assert err == "cbsr-qa: aborted\n"
    assert bool(out) == as_json
    if as_json:
        assert json.loads(out)["aborted"]["reason"] == "stopped from the keyboard"


# --- output that gets nowhere ---


def ended(command, **streams):
    """Run the command line with a command in the place of its own; return its exit code."""
    code = f"""
    import sys
    from cbsr_qa.cli import main
    from cbsr_qa.cli.output import emit_json, note, say
    def app(arguments, **options):
        {command}
    main.app = app
    sys.exit(main.run_guarded(["run", *sys.argv[1:]]))
    """
    program = [sys.executable, "-c", textwrap.dedent(code)]
    return subprocess.run(program, check=False, text=True, timeout=60, **streams)


@pytest.mark.rest
@pytest.mark.parametrize("printed", ['say("PASS")', 'emit_json({"outcome": "fail"})'])
@pytest.mark.parametrize("code", [0, 1])
def test_an_outcome_that_could_not_be_printed_is_no_outcome(printed, code):
    with Path("/dev/full").open("w") as full:
        done = ended(f"{printed}; return {code}", stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 3
    assert "the output could not be written: No space left on device" in done.stderr
    assert "cbsr-qa report RUN" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_refusal_that_could_not_be_printed_is_still_one():
    refuse = 'from cbsr_qa.domain.errors import ConfigError; raise ConfigError("no such key")'
    with Path("/dev/full").open("w") as full:
        assert ended(refuse, stdout=full, stderr=full).returncode == 2


@pytest.mark.rest
@pytest.mark.parametrize("code", [0, 1])
def test_messages_that_nobody_can_read_stop_nothing(code):
    with Path("/dev/full").open("w") as full:
        done = ended(
            f'note("running the station …"); say("done"); return {code}', stdout=subprocess.PIPE, stderr=full
        )
    assert (done.returncode, done.stdout) == (code, "done\n")


@pytest.mark.rest
@pytest.mark.parametrize("code", [0, 1])
def test_a_program_whose_output_was_closed_ends_as_it_would(code):
    def close():
        os.close(1)
        os.close(2)

    assert ended(f'note("busy"); say("FAIL"); return {code}', preexec_fn=close).returncode == code


@pytest.mark.rest
@pytest.mark.parametrize("code", [0, 1])
def test_a_reader_that_has_gone_changes_no_exit_code(code):
    reader, writer = os.pipe()
    os.close(reader)
    done = ended(f'say("FAIL"); say("run 1"); return {code}', stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    assert (done.returncode, done.stderr) == (code, "")


def test_a_broken_pipe_of_an_instrument_is_not_a_reader_that_has_gone(monkeypatch, capsys):
    monkeypatch.setattr(main, "app", _raising(BrokenPipeError(32, "Broken pipe")))
    assert main.run_guarded(["run"]) == 3
    assert "Broken pipe" in capsys.readouterr().err


def test_help_that_nobody_reads_ends_quietly():
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [Path(sys.executable).with_name("cbsr-qa"), "run", "--help"],
        check=False,
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")
