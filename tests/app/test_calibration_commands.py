"""The commands that look at a calibration file and check it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from calibration_samples import sample_calibration
from typer.testing import CliRunner

from cbsr_qa.calibration.file import stamped, verify_calibration_file, write_calibration
from cbsr_qa.cli import app
from cbsr_qa.domain import CalibrationError


@pytest.fixture
def issued(tmp_path: Path) -> Path:
    path = tmp_path / "calibrations" / "S-001.h5"
    write_calibration(path, sample_calibration())
    return path


def _run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["calibration", *arguments])


def test_show_prints_what_a_reader_needs(issued):
    shown = _run("show", str(issued)).output
    assert "sensor S-001 ü" in shown
    assert "batch        batch 41" in shown
    assert "simulated    bench" in shown
    assert "force: 0.9 to 3.5 N" in shown
    assert "assumed, not measured on this sensor: α against stress, β against stress" in shown
    assert "at least 29.5" in shown
    assert "μ = 0.03, chosen by l-curve" in shown
    (line,) = [line for line in shown.splitlines() if line.strip().startswith("L0")]
    assert line.split() == ["L0", "0.0", "0.0", "0.31", "0.004", "3"]
    (line,) = [line for line in shown.splitlines() if line.strip().startswith("L1 ")]
    assert line.endswith("no blob was sensed")


def test_show_as_json_is_one_document(issued):
    document = json.loads(_run("show", str(issued), "--json").stdout)
    assert document["identity"]["serial"] == "S-001 ü"
    assert document["baseline_conductance"][1]["value"] is None
    assert document["digest"] == verify_calibration_file(issued).digest
    assert document["record_digest"] == stamped(sample_calibration()).record_digest
    assert document["against_stress"]["covariance"] == -1.5e-8
    assert (document["image"]["noise_figure_nominal"], document["image"]["noise_figure_measured"]) == (1.02, 1.17)
    assert document["area_overlap"]["size_ratio"] == [1 / 3, 3.0]
    image = document["image"]
    assert (image["regularisation_name"], image["regularisation_criterion"]) == ("μ", "l-curve")
    assert (image["regularisation"], image["regularisation_how"]) == (0.03, "chosen for a test")


def test_verify_says_sound(issued):
    assert "is sound" in _run("verify", str(issued)).output
    document = json.loads(_run("verify", str(issued), "--json").stdout)
    assert document["sound"] is True
    assert document["schema_version"] == 2


def test_commands_refuse_with_exit_code_two(issued):
    issued.write_bytes(issued.read_bytes()[:-100])
    for command in ("show", "verify"):
        error = _run(command, str(issued)).exception
        assert isinstance(error, CalibrationError)
        assert error.exit_code == 2
        assert issued.name in error.reason


def test_control_characters_in_a_file_do_not_reach_the_terminal(tmp_path):
    path = tmp_path / "hostile.h5"
    sample = sample_calibration()
    write_calibration(path, replace(sample, sensor=replace(sample.sensor, serial="\x1b[2JS\r1")))
    shown = _run("show", str(path)).output
    assert "\x1b" not in shown
    assert "\r" not in shown
