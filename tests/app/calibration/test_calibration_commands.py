"""The commands that look at a calibration file and check it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from calibration_samples import INDENTER, LOAD_CELL, sample_calibration
from force_calibration import force_calibration
from typer.testing import CliRunner

from cbsr_qa.calibration.file.entries import encode
from cbsr_qa.calibration.file.hdf5 import stamp, verify_calibration_file, write_calibration
from cbsr_qa.cli.main import app
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.kept import walk_fields
from cbsr_qa.domain.results.calibration import Calibration


@pytest.fixture
def issued(tmp_path: Path) -> Path:
    path = tmp_path / "calibrations" / "S-001.h5"
    write_calibration(path, sample_calibration())
    return path


def _run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["calibration", *arguments])


def test_show_prints_what_a_reader_needs(issued):
    shown = _run("show", str(issued), "--all").output
    assert "sensor S-001 ü" in shown
    assert "batch        batch 41" in shown
    assert "simulated    bench" in shown
    assert "force: 0.9 to 3.5 N" in shown
    assert "Assumed, not measured on this sensor: α against stress, β against stress" in shown
    assert "at least 29.5" in shown
    (line,) = [
        line for line in shown.splitlines() if line.strip().startswith("reconstruction/regularisation_criterion")
    ]
    assert line.split()[-1] == "l-curve"
    (line,) = [line for line in shown.splitlines() if line.strip().startswith("L0")]
    assert line.split() == ["L0", "0.0", "0.0", "0.31", "0.004", "3"]
    (line,) = [line for line in shown.splitlines() if line.strip().startswith("L1 ")]
    assert line.endswith("no blob was sensed")


def test_show_as_json_is_one_document(issued):
    document = json.loads(_run("show", str(issued), "--json").stdout)
    assert document["identity"]["serial"] == "S-001 ü"
    assert document["baseline_conductance"][1]["value"] is None
    assert document["digest"] == verify_calibration_file(issued).digest
    assert document["record_digest"] == stamp(sample_calibration()).record_digest
    assert document["against_stress"]["covariance"] == -1.5e-8
    values = {path: field["value"] for path, field in document["values"].items()}
    assert (values["reconstruction/noise_figure"], values["image/measured_noise_figure"]) == (1.02, 1.17)
    assert values["area_overlap/size_ratio"] == [1 / 3, 3.0]
    assert values["reconstruction/regularisation_how"] == "chosen for a test"
    assert document["values"]["reference/current"]["units"] == "A"
    assert document["values"]["reference/voltages"]["shape"] == list(sample_calibration().reference.shape)


def test_show_says_what_the_sensor_does_and_only_with_all_every_field(issued):
    shown = _run("show", str(issued)).output
    assert "What it does" in shown
    assert "Settles in at least" in shown
    assert "Assumed, not measured on this sensor" in shown
    assert "reconstruction/" not in shown
    assert len(shown.splitlines()) < len(_run("show", str(issued), "--all").output.splitlines()) / 3


def test_show_says_what_errors_of_force_include(issued, tmp_path):
    shown = _run("show", str(issued), "--all").output
    assert "Standard errors of force include scatter only; load cell not stated." in shown
    path = tmp_path / "traced.h5"
    write_calibration(path, replace(sample_calibration(), standards=(LOAD_CELL, INDENTER)))
    shown = " ".join(_run("show", str(path), "--all").output.split())
    assert (
        "Standard errors of force include scatter and load cell (U = 0.5 % (k = 2), certificate K-2026-0711" in shown
    )
    assert "Head, whose diameter counts for forces of other heads: U = 0.02 mm (k = 2)" in shown
    document = json.loads(_run("show", str(path), "--json").stdout)
    assert document["standards"][0]["certificate"] == "K-2026-0711"
    assert document["force_error"].startswith("scatter and load cell (U = 0.5 % (k = 2)")


def test_show_states_u_of_the_day_and_of_use_with_what_each_leaves_out(tmp_path):
    path = tmp_path / "stated.h5"
    write_calibration(path, force_calibration())
    document = json.loads(_run("show", str(path), "--json").stdout)
    assert document["no_expanded_forces"] is None
    for one in document["expanded_forces"]:
        assert one["in_use"]["U_N"] >= one["U_N"] > 0
        assert set(one["in_use"]["not_stated"]) - set(one["not_stated"]) == {
            "temperature",
            "drift of gains since the reference",
            "ageing of the sensor",
        }
    shown = " ".join(_run("show", str(path), "--all").output.split())
    assert "U without: load cell, drift of the load cell" in shown


def test_show_says_why_no_u_is_stated(tmp_path):
    path = tmp_path / "none.h5"
    write_calibration(path, stamp(replace(sample_calibration(), force=None, no_force="no load had a force")))
    none = json.loads(_run("show", str(path), "--json").stdout)
    assert none["expanded_forces"] == []
    assert "no uncertainty of it: no load had a force" in none["no_expanded_forces"]
    assert "None is stated:" in _run("show", str(path), "--all").output


def test_every_field_of_the_field_table_is_shown(issued):
    """All that the table names and the file holds is in the document; a person sees no long array, nothing twice."""
    calibration = sample_calibration()
    kept = {path for path, _ in walk_fields(Calibration) if not path.endswith("/")}
    held = kept & set(encode(calibration))
    assert {"identity/issued_at", "validity/strain", "reconstruction/method", "image/mask"} <= held
    values = json.loads(_run("show", str(issued), "--json").stdout)["values"]
    assert held <= set(values)
    listed = {
        line.split()[0] for line in _run("show", str(issued), "--all").output.splitlines() if line.startswith("    ")
    }
    in_sections = ("assumed", "baseline_conductance/", "identity/", "settling/", "validity/")
    assert not [path for path in listed if path.startswith(in_sections)]
    not_shown = {path for path in values if path not in listed and not path.startswith(in_sections)}
    assert all(values[path]["value"] is None and len(values[path]["shape"]) > 0 for path in not_shown)


def test_verify_says_sound(issued):
    assert "is sound" in _run("verify", str(issued)).output
    document = json.loads(_run("verify", str(issued), "--json").stdout)
    assert document["sound"] is True
    assert document["schema_version"] == 5


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
