"""Sensors scanned one after the other: what is no serial number, what comes during a run, and Ctrl-C."""

import os
import signal
import subprocess

import pytest
from command import PROGRAM
from killing import write_files


@pytest.mark.rest
def test_a_run_is_stopped_in_order_and_no_scan_is_lost_silently(tmp_path):
    write_files(tmp_path)
    station = tmp_path / "station.toml"  # paced: the run is under way until it is stopped
    station.write_text(station.read_text().replace('clock = "virtual"', 'clock = "virtual"\nclock_speed = 10', 1))
    with subprocess.Popen(
        [str(PROGRAM), "line", "--station", "station.toml", "--recipe", "recipe.toml"],
        cwd=tmp_path,
        env={**os.environ, "CBSR_QA_VAR": "var"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        process.stdin.write("\nno serial!\nS-1\n")
        process.stdin.flush()
        said = []
        for line in process.stderr:
            said.append(line)
            if "press 1 of 6" in line:
                process.stdin.write("S-2\n")
                process.stdin.flush()
            if "'S-2' is ignored: the run of S-1" in line:
                process.send_signal(signal.SIGINT)
            if "'S-2' was scanned during the run" in line:
                process.stdin.write("quit\n")
                process.stdin.flush()
        printed = process.stdout.read()
    text = "".join(said)
    assert printed == "0 passed, 0 failed, 1 not finished; yield –\n"
    assert process.returncode == 0
    assert "not a serial number: serial number 'no serial!'" in text
    assert "S-1:  NO VERDICT" in text
    assert "set it aside" in text
