import h5py
import numpy as np
import pytest
import scipy.io

from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.readings.frames import ReadingFlag, ReadOptions
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa_plugins.recordings.cbsr_recording import CbsrRecording
from cbsr_qa_plugins.recordings.ds_tank_text import DsTankText
from cbsr_qa_plugins.recordings.eidors_mat import EidorsMat

USABLE = adjacent_pattern(16).usable()


def vectors(count, seed=1):
    frames = np.random.default_rng(seed).integers(100, 3000, (count, 16, 16)) * USABLE
    return frames, frames.reshape(count, 256).T.astype(np.int16)


@pytest.fixture
def mat(tmp_path):
    path = tmp_path / "tank.mat"
    content = {"zc_demo3": vectors(9)[1], "zc_h_demo3": vectors(1, 2)[1], "zc_other": vectors(3, 3)[1]}
    scipy.io.savemat(path, {**content, "ecg": np.zeros((544, 1)), "note": "words"})
    assert EidorsMat().recognises(path, path.read_bytes()[:4096])
    return path


def test_matrices_of_256_rows_are_the_data_sets(mat):
    assert set(EidorsMat().datasets(mat)) == {"zc_demo3", "zc_h_demo3", "zc_other"}


def test_a_data_set_must_be_chosen_and_they_are_listed(mat):
    with pytest.raises(
        RecordingError, match=r"holds 3 data sets and none was chosen: .*zc_demo3 \(9 frames\)"
    ) as said:
        EidorsMat().read(mat, ReadOptions())
    assert "--dataset" in said.value.remedy
    with pytest.raises(RecordingError, match="no data set 'zc_demo9'"):
        EidorsMat().read(mat, ReadOptions("zc_demo9"))


def test_columns_are_frames_and_the_reference_follows_from_the_name(mat):
    recording = EidorsMat().read(mat, ReadOptions("zc_demo3"))
    np.testing.assert_array_equal(recording.frames.voltages, vectors(9)[0])
    np.testing.assert_array_equal(recording.reference.voltages, vectors(1, 2)[0])
    np.testing.assert_array_equal(recording.frames.flags[0] == ReadingFlag.MISSING, ~USABLE)
    assert recording.magnitudes_only
    assert not recording.still
    np.testing.assert_allclose(np.diff(recording.frames.time_s), 1 / 7)  # documented by the data's authors


def test_a_named_reference_leaves_the_convention_out(mat):
    recording = EidorsMat().read(mat, ReadOptions("zc_demo3", (mat, "zc_other")))
    assert recording.reference is None  # the analysis reads the named one, by its own format
    assert not any("by its name" in note for note in recording.notes)
    assert EidorsMat().read(mat, ReadOptions("zc_other")).reference is None


def test_a_file_with_one_matrix_needs_no_choice_and_may_be_still(tmp_path):
    path = tmp_path / "one.mat"
    scipy.io.savemat(path, {"vv": vectors(1)[1].astype(float)})
    recording = EidorsMat().read(path, ReadOptions())
    assert (recording.dataset, recording.still) == ("vv", True)


@pytest.mark.parametrize("cut", [200, 700, 3000])
def test_a_cut_mat_file_is_refused_by_name(mat, tmp_path, cut):
    path = tmp_path / "cut.mat"
    path.write_bytes(mat.read_bytes()[:cut])
    with pytest.raises(RecordingError, match=r"cut\.mat"):
        EidorsMat().read(path, ReadOptions("zc_demo3"))


def test_a_mat_file_without_frames_is_refused(tmp_path):
    path = tmp_path / "none.mat"
    scipy.io.savemat(path, {"x": np.zeros((100, 2))})
    with pytest.raises(RecordingError, match="no matrix of 256 or 1024 rows"):
        EidorsMat().read(path, ReadOptions())


def ds_file(folder, name, values, *, rows_twice=True):
    head = ["#MEAS", "#Length, 208", "#Vector, Vr Vi I", "#Electrodes, 16", "#Start"]
    rows = [f"{value!r} -0.001 0.0003" for value in values]
    rows += rows[-1:] if rows_twice else []
    path = folder / name
    path.write_text("\n".join(line.ljust(80) for line in head + rows) + "\n")
    assert DsTankText().recognises(path, path.read_bytes()[:4096])
    return path


@pytest.mark.parametrize("rows_twice", [True, False])
def test_208_rows_fill_the_usable_readings_in_rising_order(tmp_path, rows_twice):
    values = [float(v) for v in np.random.default_rng(4).uniform(0.001, 0.03, 208)]
    path = ds_file(tmp_path, "metal.txt", values, rows_twice=rows_twice)
    recording = DsTankText().read(path, ReadOptions())
    np.testing.assert_array_equal(recording.frames.voltages[0][USABLE], values)
    assert recording.frames.voltages[0][1, 3] == values[13]  # drive 1 skips measure pairs 0, 1 and 2
    assert recording.still
    assert recording.magnitudes_only
    assert recording.rows_rejected == (1 if rows_twice else 0)
    assert recording.layout.electrode_at(0.0, 1.0) == 0  # at the top …
    assert recording.layout.electrode_at(1.0, 0.0) == pytest.approx(4)  # … and clockwise


@pytest.mark.parametrize("keep", [0, 100, 207])
def test_a_cut_tank_file_is_refused_with_its_count(tmp_path, keep):
    path = ds_file(tmp_path, "cut.txt", [0.01 * k + 0.01 for k in range(208)])
    path.write_text("\n".join(path.read_text().split("\n")[: 5 + keep]) + "\n")
    with pytest.raises(RecordingError, match=f"cut.txt has {keep} rows"):
        DsTankText().read(path, ReadOptions())


@pytest.mark.parametrize("twice", [True, False])
@pytest.mark.parametrize("damage", ["lost", "bad"])
@pytest.mark.parametrize("row", [0, 100, 207])
def test_one_row_less_refuses_the_file_whatever_fills_the_hole(tmp_path, row, damage, twice):
    """Readings have no place but their order: a doubled last row must not stand in for one that is missing."""
    path = ds_file(tmp_path, "hole.txt", [0.01 * k + 0.01 for k in range(208)], rows_twice=twice)
    lines = path.read_text().split("\n")
    rows = [5 + row, 213] if twice and row == 207 else [5 + row]
    for at in reversed(rows):
        lines[at : at + 1] = [] if damage == "lost" else ["nan nan nan"]
    path.write_text("\n".join(lines))
    with pytest.raises(RecordingError, match="207 rows" if damage == "lost" else f"line {6 + row}") as said:
        DsTankText().read(path, ReadOptions())
    assert said.value.remedy
    if damage == "bad":
        assert said.value.problems[0].line == 6 + row


@pytest.mark.parametrize(("ending", "userblock"), [(".mat", 512), (".data", 512), (".mat", 0)])
def test_matlab_7_3_is_refused_with_how_to_save_it(tmp_path, ending, userblock):
    path = tmp_path / f"new{ending}"
    with h5py.File(path, "w", userblock_size=userblock) as file:
        file["vv"] = np.zeros((256, 1))
    if userblock:
        with path.open("r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))
    assert EidorsMat().recognises(path, path.read_bytes()[:4096])
    assert not CbsrRecording().recognises(path, path.read_bytes()[:4096])
    with pytest.raises(RecordingError, match=r"version 7\.3") as said:
        EidorsMat().read(path, ReadOptions())
    assert "-v7" in said.value.remedy


def test_a_matrix_with_values_that_are_none_is_refused_for_that(tmp_path):
    path = tmp_path / "nan.mat"
    matrix = vectors(2)[1].astype(float)
    matrix[17, 1] = np.nan
    scipy.io.savemat(path, {"vv": matrix})
    with pytest.raises(RecordingError, match="vv holds values that are not finite"):
        EidorsMat().read(path, ReadOptions())


def test_a_ring_of_32_electrodes_has_rows_of_its_own(tmp_path):
    path = tmp_path / "rings.mat"
    large = np.arange(1, 1025, dtype=float).reshape(-1, 1)
    scipy.io.savemat(path, {"vvRef": large, "vvAvg1": 1.5 * large, "vvAvg2": np.ones((256, 1))})
    recording = EidorsMat().read(path, ReadOptions("vvAvg1"))
    assert recording.layout.count == 32
    assert recording.frames.voltages[0, 2, 7] == 1.5 * (32 * 2 + 7 + 1)
    assert recording.reference.voltages.shape == (1, 32, 32)
    smaller = EidorsMat().read(path, ReadOptions("vvAvg2"))
    assert smaller.frames.voltages.shape == (1, 16, 16)
    assert smaller.reference is None
    assert any("vvRef of the same file is of another ring" in note for note in smaller.notes)
