"""Errors at the command line: one message, the right exit code, one document."""

import json

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
    assert main.guarded(["run"]) == code
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("cbsr-qa: ")
    assert "Traceback" not in said.err


def test_with_json_a_refusal_and_an_internal_error_are_documents(monkeypatch, capsys):
    monkeypatch.setattr(main, "app", _raising(ConfigError("no such key", remedy="use another")))
    main.guarded(["run", "--json"])
    assert json.loads(capsys.readouterr().out) == {"refused": {"reason": "no such key", "remedy": "use another"}}
    monkeypatch.setattr(main, "app", _raising(ZeroDivisionError("division by zero")))
    main.guarded(["run", "--json"])
    assert "ZeroDivisionError: division by zero" in json.loads(capsys.readouterr().out)["broken"]["reason"]


def test_a_traceback_can_be_asked_for(monkeypatch, capsys):
    monkeypatch.setattr(main, "app", _raising(ZeroDivisionError("division by zero")))
    monkeypatch.setenv("CBSR_QA_TRACEBACK", "1")
    main.guarded(["run"])
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[], ["run"], ["run", "--nonsense"], ["nonsense"], ["calibration"]])
def test_a_misused_command_line_ends_with_2_and_says_so_on_stderr(capsys, arguments):
    assert main.guarded(arguments) == 2
    said = capsys.readouterr()
    # Help that nobody asked for by --help is shown by typer itself where it likes; a mistake goes to stderr.
    assert said.err.strip() or "Usage" in said.out


@pytest.mark.parametrize("command", ["run", "analyse", "report", "export", "scene", "calibration", "plugins", "db"])
def test_every_command_has_help(capsys, command):
    assert main.guarded([command, "--help"]) == 0
    assert "Usage" in capsys.readouterr().out


@pytest.mark.parametrize("as_json", [False, True])
def test_ctrl_c_in_any_command_is_said(monkeypatch, capsys, as_json):
    """typer makes an exit code of it, without a word."""
    monkeypatch.setattr(main, "app", lambda *_, **__: 130)
    assert main.guarded(["analyse", "x.csv", *["--json"] * as_json]) == 3
    out, err = capsys.readouterr()
    assert err == "cbsr-qa: aborted\n"
    assert bool(out) == as_json
    if as_json:
        assert json.loads(out)["aborted"]["reason"] == "stopped from the keyboard"
