import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cbsr_qa.analysis import recording_files
from cbsr_qa.analysis.recording.reading import read_recording_file
from cbsr_qa.analysis.recording_files import SCHEMA_VERSION, read_recording, write_recording
from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.readings.frames import FrameBlock, ReadOptions, Recording, SampleBlock, ScanKind, VoltageUnit
from cbsr_qa.domain.readings.loads import Load, LoadRecord
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.plugin.discovery import discover
from cbsr_qa_plugins.recordings.cbsr_recording import CbsrRecording


def sample(*, reading_times=True, reference=True):
    rng = np.random.default_rng(1)
    times = 10 + 2.5 * np.arange(6)
    own = times[:, None, None] + np.linspace(-1, 1, 256).reshape(16, 16) if reading_times else None
    flags = rng.integers(0, 8, (6, 16, 16)).astype(np.uint8)
    block = FrameBlock(times, rng.normal(size=(6, 16, 16)), flags, VoltageUnit.VOLT, 0.001, own)
    load = LoadRecord(0, Load("L0", 1.0, -2.0, 0.2, 1), 12.0, 13.2, 20.0, 21.0, 24.0)
    return Recording(
        path=Path("x.h5"),
        format="cbsr-recording",
        dataset="",
        scan=ScanKind.FULL,
        frames=block,
        reference=block.select(slice(0, 2)) if reference else None,
        still=False,
        magnitudes_only=False,
        clock="computer",
        samples=(SampleBlock("force", "N", times, rng.normal(size=6)),),
        loads=(load,),
        layout=ElectrodeLayout(16, ElectrodeKind.PIN, 48.0, 0.65, 90.0, counterclockwise=False),
        sensor_type="disc-100mm",
        notes=("run <x>", "µ"),
        simulated=("sheet: <bench>, seed 7",),
    )


def same_block(one, other):
    assert (one.unit, one.current_A) == (other.unit, other.current_A)
    for name in ("time_s", "voltages", "flags"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    if other.reading_time_s is None:
        assert one.reading_time_s is None
    else:
        np.testing.assert_array_equal(one.reading_time_s, other.reading_time_s)


@pytest.mark.parametrize("reading_times", [True, False])
@pytest.mark.parametrize("reference", [True, False])
def test_what_is_written_is_read_back_to_the_bit(tmp_path, reading_times, reference):
    before, path = sample(reading_times=reading_times, reference=reference), tmp_path / "a.h5"
    write_recording(path, before)
    after = read_recording(path)
    same_block(after.frames, before.frames)
    if reference:
        same_block(after.reference, before.reference)
    for name in ("loads", "layout", "sensor_type", "notes", "simulated", "scan", "clock", "still"):
        assert getattr(after, name) == getattr(before, name)
    np.testing.assert_array_equal(after.samples[0].values, before.samples[0].values)
    assert list(tmp_path.iterdir()) == [path]  # no temporary file is left


@pytest.fixture
def path(tmp_path):
    write_recording(tmp_path / "a.h5", sample())
    return tmp_path / "a.h5"


def test_a_file_that_a_notebook_has_open_is_read(path):
    with h5py.File(path):
        read = read_recording_file(path, discover(), format_=None, dataset=None)
    np.testing.assert_array_equal(read.frames.voltages, read_recording(path).frames.voltages)


def test_when_the_head_left_the_sheet_is_kept_press_by_press(tmp_path):
    (load,) = sample().loads
    presses = replace(load, clear_s=20.4), replace(load, index=1)
    write_recording(tmp_path / "a.h5", replace(sample(), loads=presses))
    assert read_recording(tmp_path / "a.h5").loads == presses


def test_files_that_hold_what_was_simulated_as_notes_say_it_too(tmp_path):
    """Exports of earlier versions have no part of their own for it."""
    path = tmp_path / "a.h5"
    write_recording(path, replace(sample(), notes=("run R-1", "simulated: a bench", "µ"), simulated=()))
    with h5py.File(path, "a") as file:
        said = json.loads(file.attrs["description"])
        del said["simulated"]
        file.attrs["description"] = json.dumps(said)
        file.attrs["sha256"] = recording_files._digest(file)
    found = read_recording(path)
    assert (found.notes, found.simulated) == (("run R-1", "µ"), ("a bench",))


def test_a_file_that_never_noted_it_reads_as_nobody_knows(tmp_path):
    write_recording(tmp_path / "a.h5", sample())
    with h5py.File(tmp_path / "a.h5") as file:
        assert "clear_s" not in file["loads"]  # as files of earlier versions
    assert [load.clear_s for load in read_recording(tmp_path / "a.h5").loads] == [None]


def test_every_dataset_states_its_unit(tmp_path):
    write_recording(tmp_path / "a.h5", sample())
    units = {}
    with h5py.File(tmp_path / "a.h5") as file:
        file.visititems(
            lambda n, item: units.update({n: item.attrs["unit"]}) if isinstance(item, h5py.Dataset) else None
        )
    assert units["frames/voltages"] == "V"
    assert units["samples/00/values"] == "N"
    assert all(units.values())


def test_the_format_counts_from_the_first_frame(path):
    assert CbsrRecording().recognises(path, path.read_bytes()[:4096])
    recording = CbsrRecording().read(path, ReadOptions())
    assert recording.frames.time_s[0] == 0
    assert recording.loads[0].press_start_s == 2.0
    assert recording.samples[0].time_s[0] == 0


def changed(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda file: file["frames/voltages"].__setitem__((0, 0, 0), 9.0), "digest"),
        (lambda file: file["frames"].attrs.__setitem__("current_A", 2.0), "digest"),
        (lambda file: file.attrs.__setitem__("schema_version", SCHEMA_VERSION + 1), "schema version 2"),
        (lambda file: file.attrs.__setitem__("format", "other"), "not a recording of this program"),
        (lambda file: file.attrs.__delitem__("sha256"), "digest"),
    ],
)
def test_an_edited_foreign_or_later_file_is_refused_by_name(path, change, said):
    changed(path, change)
    with pytest.raises(RecordingError, match=said):
        read_recording(path)


@pytest.mark.parametrize("share", [0.01, 0.3, 0.9, 0.999])
def test_a_cut_file_is_refused(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(RecordingError, match=r"a\.h5"):
        read_recording(path)


def test_a_folder_that_cannot_be_written_to_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be written"):
        write_recording(tmp_path / "file" / "a.h5", sample())


def test_a_lost_sample_is_no_sample(tmp_path):
    path, before = tmp_path / "a.h5", sample()
    (force,) = before.samples
    force.values[3] = np.nan
    write_recording(path, before)
    np.testing.assert_array_equal(read_recording(path).samples[0].time_s, np.delete(force.time_s, 3))


@pytest.mark.rest
def test_a_full_disk_is_refused_in_one_message_and_leaves_nothing(tmp_path):
    code = (
        "import resource, sys; sys.path.insert(0, 'tests/analysis')\n"
        "from pathlib import Path; from test_recording_file import sample, write_recording\n"
        "from cbsr_qa.domain.errors import RecordingError\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))  # a disk that ends within the file\n"
        "try: write_recording(Path(sys.argv[1]), sample())\n"
        "except RecordingError as error: print(error.reason)"
    )
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "x.h5"], capture_output=True, text=True, check=True)
    assert "x.h5 cannot be written: File too large" in done.stdout
    assert done.stderr == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_interruption_while_writing_leaves_nothing(tmp_path, monkeypatch, error):
    def interrupted(file):
        raise error

    monkeypatch.setattr(recording_files, "_digest", interrupted)
    with pytest.raises(error):
        write_recording(tmp_path / "x.h5", sample())
    assert list(tmp_path.iterdir()) == []
