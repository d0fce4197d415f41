"""A run of the installed program that gets signals: what it says, how it ends, what it leaves."""

import json
import os
import signal
import subprocess

import pytest
from command import PROGRAM, cbsr_qa, document

from cbsr_qa.config.documents import DocumentKind, open_document


def _stopped(folder, *signals, at="nine locations (2 of 4)"):
    """Start a run, send signals when it says it is somewhere; return exit code, document, stderr."""
    files = ["--station", "simulated", "--recipe", "nine-locations", "--serial", "S-1", "--seed", "3", "--json"]
    process = subprocess.Popen(
        [str(PROGRAM), "run", *files],
        cwd=folder,
        env={**os.environ, "CBSR_QA_VAR": "var"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    said = []
    for line in process.stderr:
        said.append(line)
        if line.startswith(at):
            for number in signals:
                process.send_signal(number)
            break
    out, err = process.communicate(timeout=120)
    return process.returncode, json.loads(out), "".join(said) + err


@pytest.mark.rest
@pytest.mark.parametrize(
    ("number", "by"),
    [(signal.SIGTERM, "by signal SIGTERM, while "), (signal.SIGINT, "by the operator (Ctrl-C), while ")],
)
def test_one_signal_ends_a_run_in_order_with_its_record_and_exit_code_3(tmp_path, number, by):
    code, run, said = _stopped(tmp_path, number)
    assert (code, run["end"], run["outcome"]) == (3, "aborted", "not measured")
    assert run["end_detail"].startswith(by)
    assert "(phase 'nine locations', step" in run["end_detail"]
    assert f"{number.name}: the run stops:" in said
    assert "A second signal makes the bench safe at once." in said
    assert "Traceback" not in said
    assert run["reason"] == f"the run was aborted: {run['end_detail']}"
    assert (tmp_path / run["report"]).is_file()
    assert run["calibration"] is None


@pytest.mark.rest
def test_another_instrument_than_the_station_file_names_is_refused_with_nothing_written(tmp_path):
    text = open_document(DocumentKind.STATION, "simulated").text
    (tmp_path / "mine.toml").write_text(f'{text}model = "simulated bench"\nserial = "4031823"\n')
    files = ["--station", "mine.toml", "--recipe", "nine-locations", "--serial", "S-1", "--json"]
    done = cbsr_qa(tmp_path, "run", *files, check=False)
    assert done.returncode == 3
    refused = document(done)["refused"]
    assert "its serial is" in refused["reason"]
    assert "the station file expects '4031823'" in refused["reason"]
    assert not (tmp_path / "var").exists()
