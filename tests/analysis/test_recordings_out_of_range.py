"""Numbers no instrument reads are refused by file and place, before anything is worked out."""

import json

import h5py
import numpy as np
import pytest
import scipy.io
from test_recording_file import sample

from cbsr_qa.analysis import recording_files
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock, VoltageUnit


def written(tmp_path, change):
    """A recording of ours after ``change`` of its file, with the digest of what it then holds."""
    path = tmp_path / "run.h5"
    recording_files.write_recording(path, sample())
    with h5py.File(path, "r+") as file:
        change(file)
        file.attrs["sha256"] = recording_files._digest(file)
    return path


def put(name, index, value):
    def change(file):
        file[name][index] = value

    return change


def retyped(name):
    def change(file):
        values, attributes = file[name][()] + 1j, dict(file[name].attrs)
        del file[name]
        file[name] = values
        file[name].attrs.update(attributes)

    return change


def current(value):
    return lambda file: file["frames"].attrs.__setitem__("current_A", value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (put("frames/time_s", 2, np.nan), "frame times"),
        (put("frames/time_s", 2, 0.0), "frame times"),
        (put("frames/voltages", (0, 0, 0), np.inf), "not a finite number"),
        (current(np.nan), "drive current"),
        (put("frames/reading_time_s", (0, 0, 0), np.nan), "time of a reading"),
        (put("frames/voltages", (2, 3, 5), 1e308), "frame 2, drive pair 3, measure pair 5 (all from 0) reads 1e+308"),
        (put("frames/voltages", (2, 3, 5), -1e16), "reads -1e+16 V; readings are at most 1e+15 V"),
        (put("reference/voltages", (1, 0, 0), 1e200), "frame 1, drive pair 0, measure pair 0"),
        (put("samples/00/values", 4, 1e308), "channel force: the value of sample 4 (from 0) is 1e+308 N"),
        (put("samples/00/time_s", 5, 1e308), "channel force: the time of sample 5 (from 0) is 1e+308 s"),
        (current(-0.001), "the drive current (current_A of /frames) is -0.001 A; it must be above 0"),
        (put("loads/press_start_s", 0, np.nan), "/loads/press_start_s, row 0 (from 0), of load"),
        (put("loads/rest_end_s", 0, np.inf), "is inf s; a finite number is expected"),
        (put("loads/x_mm", 0, np.nan), "/loads/x_mm, row 0 (from 0)"),
        (current(1e308), "the drive current is 1e+308 A"),
        (current(1e-308), "the drive current is 1e-308 A"),
        (retyped("frames/voltages"), "/frames/voltages holds values of type complex128, not real numbers"),
        (retyped("frames/time_s"), "/frames/time_s holds values of type complex128"),
        (retyped("samples/00/values"), "/samples/00/values holds values of type complex128"),
        (retyped("loads/x_mm"), "/loads/x_mm holds values of type complex128"),
    ],
)
def test_a_recording_is_refused_by_file_and_place(tmp_path, capsys, change, said):
    path = written(tmp_path, change)
    assert run_guarded(["analyse", str(path), "--json", "--no-report"]) == 2
    refused = json.loads(capsys.readouterr().out)["refused"]
    assert refused["reason"].startswith("run.h5: ")
    assert said in refused["reason"]
    assert refused["remedy"]


@pytest.mark.parametrize(
    ("content", "asked", "said"),
    [
        ({"v": np.ones((256, 3)) + 1j}, [], "a.mat: v holds complex voltages"),
        (
            {"v": np.ones((256, 3)) + 1j, "w": np.ones((256, 3))},
            ["--dataset", "v"],
            "a.mat: v holds complex voltages",
        ),
        ({"v": np.full((256, 3), 1e308)}, [], "a.mat: frame 0, drive pair 0, measure pair 2"),
        ({"v": np.full((256, 3), np.nan), "w": np.ones((256, 3))}, ["--dataset", "v"], "a.mat: v holds values that"),
    ],
)
def test_a_matlab_file_is_refused_by_file_and_data_set(tmp_path, capsys, content, asked, said):
    scipy.io.savemat(tmp_path / "a.mat", content)
    assert run_guarded(["analyse", str(tmp_path / "a.mat"), *asked, "--json", "--no-report"]) == 2
    assert json.loads(capsys.readouterr().out)["refused"]["reason"].startswith(said)


@pytest.mark.parametrize("largest", [1e15, -1e15])
def test_the_bounds_themselves_are_readings(largest):
    values = np.full((1, 2, 2), largest)
    FrameBlock(np.zeros(1), values, np.zeros(values.shape, np.uint8), VoltageUnit.COUNT, 1e-15)
    SampleBlock("force", "N", np.zeros(1), np.array([largest]))
