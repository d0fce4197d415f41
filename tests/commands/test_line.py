"""Sensors scanned one after the other: PIN, questions, what is no serial number, what comes during a run, signals."""

import os
import signal
import subprocess

import pytest
from command import PROGRAM
from killing import write_files

from cbsr_qa.system.pins import hash_pin

_GATE = '[gate]\noperator = "refuse"\n[[gate.operators]]\nname = "Ada"\npin = "{pin}"\n\n[indenter]'
_ASKS = '\n[[phases]]\nname = "questions"\nsequence = "operator-prompt"\ntext = "Is it <dry>?"\n\n[[phases]]'
_OPTIONS = ["line", "--station", "station.toml", "--recipe", "recipe.toml", "--operator", "Ada"]


@pytest.fixture
def folder(tmp_path):
    """A paced station, so that a run is under way until it is stopped, with a PIN; a recipe that asks first."""
    write_files(tmp_path)
    station, recipe = tmp_path / "station.toml", tmp_path / "recipe.toml"
    paced = station.read_text().replace('clock = "virtual"', 'clock = "virtual"\nclock_speed = 40', 1)
    station.write_text(paced.replace("[indenter]", _GATE.format(pin=hash_pin("4711")), 1))
    recipe.write_text(recipe.read_text().replace("\n[[phases]]", _ASKS, 1))
    return tmp_path


@pytest.mark.rest
def test_runs_are_answered_and_stopped_in_order_and_no_scan_is_lost_silently(folder):
    with subprocess.Popen(
        [str(PROGRAM), *_OPTIONS],
        cwd=folder,
        env={**os.environ, "CBSR_QA_VAR": "var"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:

        def types(text):
            process.stdin.write(text)
            process.stdin.flush()

        types("4711\n\nno serial!\nS-1\n")
        said = []
        for heard in process.stderr:
            said.append(heard)
            if heard == "  Is it <dry>?\n":
                if "S-3" in "".join(said):
                    process.send_signal(signal.SIGTERM)
                else:
                    types("yes\n")
            if "press 1 of 6" in heard:
                types("S-2\n")
            if "'S-2' is ignored: the run of S-1" in heard:
                process.send_signal(signal.SIGINT)
            if "'S-2' was scanned during the run" in heard:
                types("S-3\n")
                said.append("S-3")
        printed = process.stdout.read()
    text = "".join(said)
    assert printed == "0 passed, 0 failed, 2 not finished; yield –\n"
    assert process.returncode == 0
    assert "not a serial number: serial number 'no serial!'" in text
    assert "S-1:  NO VERDICT" in text
    assert "S-3:  NO VERDICT" in text
    assert "set it aside" in text
    assert "4711" not in text
