"""A calibration applied to recordings: the right numbers, and a refusal by name where there are none."""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from force_calibration import SCALE, force_calibration, frames
from stored_runs import SENSOR_TYPE
from typer.testing import CliRunner

from cbsr_qa.analysis.recording_files import read_recording, write_recording
from cbsr_qa.app.calibration.apply import flag_words, is_increasing
from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.calibration.runtime.frame_scale import FrameScale, check_recording
from cbsr_qa.cli.main import app
from cbsr_qa.domain.errors import RecordingError, RefusedError
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, Recording, ScanKind, VoltageUnit

_PLACE = (5.0, 7.0)
_FORCE = np.array([0.0, 0.0, 0.0, 0.0, 2.0, 3.0, 4.0])


@pytest.fixture(scope="module")
def calibration():
    return Calibration(force_calibration())


def _recording(voltages=None, *, flags=None, unit=VoltageUnit.VOLT, current_A=4e-4, **changes):
    seen = frames(np.tile(_PLACE, (len(_FORCE), 1)), _FORCE) if voltages is None else voltages
    block = FrameBlock(
        2.5 * np.arange(len(seen)), seen, np.zeros(seen.shape, np.uint8) if flags is None else flags, unit, current_A
    )
    values = {
        "path": Path("press.h5"),
        "format": "cbsr-recording",
        "dataset": "",
        "scan": ScanKind.FULL,
        "frames": block,
        "reference": None,
        "still": False,
        "magnitudes_only": False,
        "clock": "station",
        "sensor_type": SENSOR_TYPE.name,
    }
    return Recording(**(values | changes))


def scale_frames(calibration, recording, reference):
    """Voltages of a recording at the calibration's scale, and what was done to them."""
    check_recording(calibration.issued, recording)
    scale = FrameScale.from_frames(calibration.issued, recording.path.name, recording.frames, reference)
    return scale.voltages(recording.frames), scale.remarks


def _force(calibration, recording, reference=None):
    return calibration.force(scale_frames(calibration, recording, reference)[0], place_mm=_PLACE)


def test_frames_of_the_calibrations_own_scale_are_taken_as_they_are(calibration):
    recording = _recording()
    voltages, remarks = scale_frames(calibration, recording, None)
    np.testing.assert_array_equal(voltages, recording.frames.voltages)
    assert remarks == ()
    error = _force(calibration, recording).force_N[4:] - _FORCE[4:]
    assert np.abs(error).max() < 0.3


def test_another_current_is_scaled_and_said(calibration):
    half = _recording(frames(np.tile(_PLACE, (7, 1)), _FORCE) / 2, current_A=2e-4)
    (said,) = scale_frames(calibration, half, None)[1]
    assert said == "readings at 0.2 mA were scaled to the calibration's 0.4 mA"
    np.testing.assert_allclose(
        _force(calibration, half).force_N, _force(calibration, _recording()).force_N, rtol=1e-9
    )


def test_counts_have_a_scale_only_where_first_frames_are_of_the_unloaded_sheet(calibration):
    """Twenty times what the volts are, and a sheet that has drifted as a whole."""
    volts = frames(np.tile(_PLACE, (7, 1)), _FORCE, noise=0.0)
    counts = _recording(20.0 * volts, unit=VoltageUnit.COUNT, current_A=None)
    with pytest.raises(RecordingError, match=r"press.h5 holds readings in count without their scale") as caught:
        scale_frames(calibration, counts, None)
    assert "--reference N" in caught.value.remedy
    voltages, remarks = scale_frames(calibration, counts, 4)
    assert "1 count is 0.05 V of the calibration" in remarks[0]
    np.testing.assert_allclose(voltages, volts, rtol=1e-9, atol=1e-12 * SCALE)
    drifted = _recording(1.03 * volts, current_A=None)
    plain = _force(calibration, _recording(volts)).force_N
    np.testing.assert_allclose(_force(calibration, drifted, 4).force_N[4:], plain[4:], rtol=1e-9)


def test_volts_at_a_current_nobody_states_have_no_scale_either(calibration):
    with pytest.raises(RecordingError, match="does not say its drive current"):
        scale_frames(calibration, _recording(current_A=None), None)


@pytest.mark.parametrize("count", [0, 8, -1])
def test_a_reference_of_no_frames_is_refused(calibration, count):
    with pytest.raises(RecordingError, match=f"--reference {count} of press.h5, which holds 7 frames; 1 to 7"):
        scale_frames(calibration, _recording(), count)


def test_first_frames_of_another_sensor_are_refused(calibration):
    turned = np.roll(frames(np.tile(_PLACE, (7, 1)), _FORCE), 3, axis=2)
    with pytest.raises(RecordingError, match="are not those of sensor S-1 unloaded") as caught:
        scale_frames(calibration, _recording(turned), 4)
    assert "order of its electrodes" in caught.value.remedy
    with pytest.raises(RecordingError, match="differ from its reference by 100%"):
        scale_frames(calibration, _recording(np.zeros((7, 16, 16))), 4)


@pytest.mark.parametrize(
    ("recording", "said"),
    [
        (_recording(sensor_type="disc-150mm"), "is of sensor type disc-150mm, the calibration is of a disc-100mm"),
        (_recording(magnitudes_only=True), "absolute values"),
        (_recording(np.zeros((2, 1, 16)), scan=ScanKind.DRIVEN_PAIRS), "driven pairs alone"),
        (
            _recording(np.zeros((2, 8, 8)), sensor_type=None),
            "frames of 8 × 8 readings, the calibration is for 16 × 16",
        ),
        (_recording(np.zeros((0, 16, 16))), "holds no frame"),
        (_recording(current_A=0.0), "states a drive current of 0 A"),
    ],
)
def test_a_recording_of_something_else_is_refused_by_name(calibration, recording, said):
    with pytest.raises(RecordingError, match=said) as caught:
        scale_frames(calibration, recording, None)
    assert caught.value.reason.startswith("press.h5 ")


def test_a_missing_or_saturated_reading_is_left_out(calibration):
    flags = np.zeros((7, 16, 16), np.uint8)
    flags[4, 0, 5] = ReadingFlag.MISSING
    flags[5, 3, 9] = ReadingFlag.SATURATED
    flags[6, 0, 0] = ReadingFlag.SATURATED  # of a driven pair: not used
    found = _force(calibration, _recording(flags=flags))
    assert found.force_N == pytest.approx(_force(calibration, _recording()).force_N, abs=0.1)
    assert (found.flags & Flag.MISSING > 0).tolist() == [False] * 4 + [True, True, False]
    with pytest.raises(RecordingError, match=r"first 5 frames of press\.h5 is missing or saturated"):
        scale_frames(calibration, _recording(flags=flags), 5)


@pytest.mark.parametrize(
    ("time_s", "in_order"),
    [([], True), ([0.0, 2.5], True), ([2.5, 0.0], False), ([1.0, 1.0], False), ([np.nan], False)],
)
def test_loads_are_followed_only_over_times_in_order(time_s, in_order):
    assert is_increasing(np.array(time_s)) is in_order


def test_every_flag_has_words():
    words = [flag_words(int(flag)) for flag in Flag]
    assert all(words)
    assert len(set(words)) == len(words)
    assert flag_words(0) == ""
    assert flag_words(Flag.OUTSIDE | Flag.BELOW_RANGE) == "outside what was calibrated; below the calibrated forces"


# --- the command ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("applied")
    write_calibration(folder / "sensor.h5", force_calibration())
    write_recording(folder / "press.h5", _recording())
    write_recording(folder / "other.h5", _recording(sensor_type="disc-150mm"))
    return folder


def _run(*arguments):
    return CliRunner().invoke(app, ["calibration", *map(str, arguments)], standalone_mode=False)


def test_apply_prints_a_row_a_frame(folder, calibration):
    done = _run("apply", folder / "sensor.h5", folder / "press.h5", "--place", 5, 7, "--output", "-")
    assert (done.return_value, done.exception) == (0, None)
    rows = list(csv.DictReader(io.StringIO(done.stdout)))
    assert len(rows) == len(_FORCE)
    expected = _force(calibration, _recording())
    assert [float(row["force_N"]) for row in rows] == pytest.approx(expected.force_N.tolist(), rel=1e-9)
    assert [float(row["time_s"]) for row in rows] == [2.5 * n for n in range(7)]
    assert rows[0]["flags"] == "no load detected"
    assert rows[5]["flags"] == "has not settled"  # two frames after the first with a load
    assert float(rows[5]["settled_in_s"]) > 40
    assert "frames 1 to 7 of 7" in done.stderr


def test_a_serial_number_that_nobody_states_is_said_not_to_be_checked(folder):
    apply = ("apply", folder / "sensor.h5", folder / "press.h5")
    done = _run(*apply, "--json")
    errors, said = json.loads(done.stdout)["recordings"][0]["remarks"]
    assert errors == "errors of force include scatter only; load cell not stated"
    assert said.startswith("not checked: that it is of sensor S-1, as the calibration is")
    assert "not checked: that it is of sensor S-1" in _run(*apply).stdout
    own = json.loads(_run(*apply, "--json", "--serial", "S-1").stdout)
    assert own["recordings"][0]["remarks"] == [errors]


def test_the_serial_number_that_a_recording_states_is_compared(folder, tmp_path):
    write_recording(tmp_path / "own.h5", _recording(serial="S-1"))
    write_recording(tmp_path / "another.h5", _recording(serial="S-2"))
    assert read_recording(tmp_path / "another.h5").serial == "S-2"
    done = _run("apply", folder / "sensor.h5", tmp_path / "own.h5", tmp_path / "another.h5", "--json")
    assert done.return_value == 2
    own, another = json.loads(done.stdout)["recordings"]
    assert not any("not checked" in remark for remark in own["remarks"])
    assert another["refused"]["reason"] == "the calibration is of sensor S-1, the recordings are of S-2"
    stated = _run("apply", folder / "sensor.h5", tmp_path / "another.h5", "--serial", "S-1", "--json")
    assert "another.h5 is of sensor S-2, and --serial states S-1" in stated.stdout


@pytest.mark.parametrize(
    ("serial", "said"),
    [
        ("S-2", "the calibration is of sensor S-1, the recordings are of S-2"),
        ("s-1", "the recordings are of s-1"),
        ("S 1", "serial number 'S 1' cannot be used"),
        ("", "it is empty"),
    ],
)
def test_another_serial_number_than_the_calibrations_is_refused(folder, tmp_path, serial, said):
    out = tmp_path / "forces.csv"
    refused = _run("apply", folder / "sensor.h5", folder / "press.h5", "--serial", serial, "--output", out)
    assert isinstance(refused.exception, RefusedError)
    assert said in str(refused.exception)
    assert not out.exists()


def test_where_every_recording_is_refused_no_table_is_written(folder, tmp_path):
    done = _run("apply", folder / "sensor.h5", folder / "other.h5", "--output", tmp_path / "all.csv")
    assert done.return_value == 2
    assert not (tmp_path / "all.csv").exists()


def test_apply_as_json_is_one_document_and_refusals_are_in_it(folder):
    done = _run("apply", folder / "sensor.h5", folder / "press.h5", folder / "other.h5", "--json")
    assert done.return_value == 2
    document = json.loads(done.stdout)
    good, bad = document["recordings"]
    assert len(good["frames"]) == len(_FORCE)
    assert good["frames"][6]["force_N"] == pytest.approx(4.0, abs=0.3)
    assert "disc-150mm" in bad["refused"]["reason"]
    assert bad["frames"] == []


@pytest.mark.rest
def test_apply_writes_no_file_over_another(folder, tmp_path):
    out = tmp_path / "forces.csv"
    assert _run("apply", folder / "sensor.h5", folder / "press.h5", "--output", out).return_value == 0
    assert len(out.read_text().splitlines()) == 1 + len(_FORCE)
    before = out.read_bytes()
    refused = _run("apply", folder / "sensor.h5", folder / "press.h5", "--output", out)
    assert "exists already" in str(refused.exception)
    assert out.read_bytes() == before


def test_apply_says_what_no_recording_and_no_model_are(folder, tmp_path):
    assert _run("apply", folder / "sensor.h5", tmp_path / "absent.h5").stdout == ""
    done = _run("apply", folder / "sensor.h5", tmp_path / "absent.h5", "--json")
    assert done.return_value == 2
    assert "there is no file" in json.loads(done.stdout)["recordings"][0]["refused"]["reason"]
    bare = replace(force_calibration(), force=None, no_force="too few loads", digest="", record_digest="")
    write_calibration(tmp_path / "bare.h5", bare)
    refused = _run("apply", tmp_path / "bare.h5", folder / "press.h5")
    assert "holds no force model: too few loads" in str(refused.exception)


# --- export and show -----------------------------------------------------------------------------------------


def test_export_there_and_back_is_the_same_file(folder, tmp_path):
    there, back = tmp_path / "x.json", tmp_path / "y.h5"
    assert "as before" in _run("export", folder / "sensor.h5", "--output", there).stdout
    document = json.loads(_run("export", there, "--output", back, "--json").stdout)
    assert (document["digest"], document["loss"]) == (force_calibration().digest, None)
    assert back.read_bytes() == (folder / "sensor.h5").read_bytes()


@pytest.mark.rest
def test_export_for_firmware_says_what_is_lost(folder, tmp_path):
    out = tmp_path / "fw.json"
    document = json.loads(
        _run("export", folder / "sensor.h5", "--output", out, "--firmware", "--stride", 4, "--json").stdout
    )
    assert document["size_bytes"] == out.stat().st_size < 4e5
    held = json.loads(out.read_text())
    assert document["loss"] == {"lattice_stride": 4, **held["loss"]}
    said = _run("export", folder / "sensor.h5", "--output", tmp_path / "again.json", "--firmware").stdout
    assert "rms" in said


def test_export_refuses_what_it_cannot_write(folder, tmp_path):
    for arguments, said in (
        (("--output", tmp_path / "x.txt"), "has an unknown suffix"),
        (("--output", tmp_path / "x.h5", "--firmware"), "firmware takes JSON"),
        (("--output", folder / "sensor.h5"), "exists already"),
        (("--output", tmp_path / "x.json", "--stride", 2), "only --firmware"),
    ):
        assert said in str(_run("export", folder / "sensor.h5", *arguments).exception)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.rest
def test_show_says_what_the_force_model_is_worth(folder, tmp_path, calibration):
    document = json.loads(_run("show", folder / "sensor.h5", "--json").stdout)
    force = document["force_model"]
    assert 0.7 < force["response_lowest"] < 1 < force["response_highest"] < 1.4
    assert force["assumed"] == [name for name in calibration.issued.assumed if name.endswith("stress")]
    assert document["no_force_model"] is None
    least = force["least_force_centre_N"]
    assert least < force["least_force_worst_N"]
    shown = _run("show", folder / "sensor.h5", "--all").stdout
    assert f"{least:.2g} N at the centre" in shown
    bare = replace(force_calibration(), force=None, no_force="too few loads", digest="", record_digest="")
    write_calibration(tmp_path / "bare.h5", bare)
    assert "none: too few loads" in _run("show", tmp_path / "bare.h5", "--all").stdout


def test_the_least_force_that_is_shown_is_the_one_that_is_detected(folder, calibration):
    """Without noise, a little more is a load and a little less is none."""
    least = json.loads(_run("show", folder / "sensor.h5", "--json").stdout)["force_model"]["least_force_centre_N"]
    seen = calibration.force(frames(np.zeros((2, 2)), least * np.array([0.85, 1.15]), noise=0.0))
    assert (seen.flags & Flag.NOT_DETECTED > 0).tolist() == [True, False]
