"""The operator at the terminal: how a text is shown, what an answer does, and what happens where nobody is there."""

import io
import os
import pty
import sys

import pytest
from station_files import station_file

from cbsr_qa.app.run import session as running
from cbsr_qa.app.run.console import Unattended
from cbsr_qa.app.run.preview import plan_run
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.cli.output import ask_operator, operator_is_there
from cbsr_qa.domain.errors import AbortedError, ConfigError, StoppedError
from cbsr_qa.station.interrupts import Stopped

INSTRUMENTS = """
[instruments.frames]
driver = "simulated-bench"
provides = ["frame_source"]
scene = "none"

[instruments.stand]
driver = "manual-applicator"
provides = ["force_applicator"]
label = "stand with spindle"
serial = "7"
number = "7"

[instruments.scale]
driver = "manual-load-cell"
provides = ["force"]
unit = "g"
capacity = 3000
"""


@pytest.fixture
def station(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "by-hand.toml").write_text(
        station_file("by-hand", INSTRUMENTS, clock="real", stale_s=120.0, answer_s=600.0)
    )
    return "by-hand.toml"


@pytest.fixture
def terminal(monkeypatch):
    """The far end of a terminal that stands for the process's input."""
    far, near = pty.openpty()
    with os.fdopen(near, "r") as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield far
    os.close(far)


def test_a_text_is_shown_on_stderr_and_the_line_comes_back(terminal, capsys):
    os.write(terminal, b" 25.8 mm \n")
    assert ask_operator("head: what the scale says [mm]:") == "25.8 mm"
    shown = capsys.readouterr()
    assert "head: what the scale says [mm]:" in shown.err
    assert shown.out == ""


@pytest.mark.parametrize("said", ["stop", "Abort ", "STOP"])
def test_an_operator_can_stop_the_run_by_an_answer(terminal, said):
    os.write(terminal, f"{said}\n".encode())
    with pytest.raises(AbortedError, match="aborted by the operator, who answered"):
        ask_operator("lift the head")


def test_an_input_that_ends_stops_the_run(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    with pytest.raises(AbortedError, match="closed the terminal's input"):
        ask_operator("lift the head")


def test_an_operator_is_there_only_at_a_terminal(terminal, monkeypatch):
    assert operator_is_there()
    monkeypatch.setattr(sys, "stdin", io.StringIO("yes\n"))
    assert not operator_is_there()
    monkeypatch.setattr(sys, "stdin", None)
    assert not operator_is_there()


def test_without_a_terminal_a_station_worked_by_hand_is_refused(station, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert (
        run_guarded(["run", "--station", station, "--recipe", "nine-locations", "--serial", "S-1", "--seed", "1"])
        == 2
    )
    said = capsys.readouterr().err
    assert (
        "cbsr-qa: instrument 'scale' (manual-load-cell) is operated by hand, and there is no operator to ask" in said
    )
    assert "start the run at a terminal" in said
    assert [path.name for path in tmp_path.iterdir()] == [station]


def test_a_dry_run_asks_nobody(station):
    request = RunRequest(station, "nine-locations", "S-1", seed=1)
    assert plan_run(request, attended=True).dry.loads > 0
    with pytest.raises(ConfigError, match="operated by hand"):
        plan_run(request)


def test_instruments_and_prompts_are_given_the_operator(station, monkeypatch):
    texts, given = [], []

    class Answering(Unattended):
        attended = True

        def ask(self, text):
            texts.append(text)
            return "yes"

    def executed(*_, **options):
        given.append(options["ask"])
        raise Stopped("the test")

    opened = running.open_station

    def opening(*arguments, **options):
        given.append(options["ask"])
        return opened(*arguments, **options)

    monkeypatch.setattr(running, "open_station", opening)
    monkeypatch.setattr(running, "execute", executed)
    with pytest.raises(StoppedError):
        run_sensor(RunRequest(station, "nine-locations", "S-1", seed=1), Answering())
    assert len(given) == 2
    assert [one("?") for one in given] == ["yes", "yes"]
    with pytest.raises(ConfigError, match="operated by hand"):
        run_sensor(RunRequest(station, "nine-locations", "S-1", seed=1))
