"""The calibration file: exact round trip, digest, atomic writing, and refusal of everything unsound."""

import hashlib
import os
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from calibration_samples import (
    assert_same,
    old_calibration,
    sample_calibration,
    sample_sensor_type,
    sparse_calibration,
)

from cbsr_qa.calibrate.digests import stamped
from cbsr_qa.calibrate.file import read_calibration, verify_calibration, write_calibration
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.mesh import Mesh


@pytest.fixture
def issued(tmp_path: Path) -> Path:
    path = tmp_path / "calibrations" / "S-001.h5"
    write_calibration(path, sample_calibration())
    return path


@pytest.mark.parametrize("make", [sample_calibration, sparse_calibration, old_calibration])
def test_every_field_comes_back_exactly(tmp_path, make):
    path = tmp_path / "sensor.h5"
    write_calibration(path, make())
    assert_same(read_calibration(path), stamped(make()), "calibration")


def _with_choice(method, **changes):
    sample = sample_calibration()
    choice = replace(sample.reconstruction.choice, **changes)
    return replace(sample, reconstruction=replace(sample.reconstruction, method=method, choice=choice))


@pytest.mark.parametrize(
    ("method", "called"),
    [("gauss-newton-noser", "λ"), ("truncated-svd", "components kept"), ("pyeit-jac", "pyEIT's lamb")],
)
def test_a_file_of_before_is_read_with_the_name_its_method_implied(tmp_path, method, called):
    """A file with two datasets fewer, whose digest is worked out as anybody would."""
    path = tmp_path / "old.h5"
    write_calibration(path, _with_choice(method))
    with h5py.File(path, "r+") as file:
        del file["reconstruction/regularisation_name"], file["reconstruction/regularisation_criterion"]
    stated = _plain_digest(path)
    with h5py.File(path, "r+") as file:
        file.attrs["digest"] = stated
    old = read_calibration(path)
    assert (old.reconstruction.choice.name, old.reconstruction.choice.criterion) == (called, "")
    assert (old.reconstruction.choice.value, old.reconstruction.choice.how) == (0.03, "chosen for a test")
    assert write_calibration(tmp_path / "again.h5", old) == stated


@pytest.mark.parametrize(("name", "criterion"), [("λ", "gcv"), ("μ", ""), ("λ", "")])
def test_name_and_criterion_come_back_whichever_is_there(tmp_path, name, criterion):
    made = _with_choice("gauss-newton-noser", name=name, criterion=criterion)
    write_calibration(tmp_path / "x.h5", made)
    assert_same(read_calibration(tmp_path / "x.h5"), stamped(made), "calibration")


def test_every_dataset_states_its_units(issued):
    units: dict[str, str] = {}
    with h5py.File(issued) as file:
        file.visititems(
            lambda name, item: (
                units.__setitem__(name, item.attrs["units"]) if isinstance(item, h5py.Dataset) else None
            )
        )
    assert units["reference/voltages"] == "V"
    assert units["mesh/nodes"] == "mm"
    assert units["quasi_static/against_stress/slope"] == "1/kPa"
    assert units["validity/force"] == "N"
    assert units["relaxation/conductance/amplitudes"] == "1"
    assert units["relaxation/stress/amplitudes"] == units["relaxation/stress/settling_band"] == "kPa"
    of_volts = {"1/V", "A.Ohm", "A.Ohm/V", "V", "V/(A.Ohm)"}
    known = of_volts | {"1", "1/kPa", "1/mm", "1/mm^2", "A", "N", "deg", "degC", "kPa", "mm", "s", "%"}
    assert set(units.values()) <= known | {"flag", "index", "text"}


def _plain_digest(path: Path) -> str:
    """The digest as the documentation describes it, with h5py and hashlib alone."""
    with h5py.File(path) as file:
        names: list[str] = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        digest = hashlib.sha256(f"cbsr-qa calibration\t{file.attrs['schema_version']}\n".encode())
        for name in sorted(names):
            dataset = file[name]
            if h5py.check_string_dtype(dataset.dtype):
                kind, texts = "text", np.atleast_1d(dataset[()])
                data = b"".join(b"%d\n%s" % (len(text), text) for text in texts)
            else:
                kind = dataset.dtype.str[1:]
                data = np.ascontiguousarray(dataset[()]).astype("<" + kind).tobytes()
            shape = "x".join(str(length) for length in dataset.shape)
            digest.update(f"{name}\t{dataset.attrs['units']}\t{kind}\t{shape}\n".encode())
            digest.update(data)
    return digest.hexdigest()


def test_the_digest_can_be_recomputed_with_h5py_and_hashlib(issued):
    with h5py.File(issued) as file:
        stated = file.attrs["digest"]
    assert _plain_digest(issued) == stated == verify_calibration(issued).digest


def test_the_digest_does_not_depend_on_the_order_of_writing(issued, tmp_path):
    copy = tmp_path / "copy.h5"
    with h5py.File(issued) as source, h5py.File(copy, "w", libver="latest", track_order=True) as target:
        for name, value in source.attrs.items():
            target.attrs[name] = value
        for name in reversed(list(source)):
            source.copy(name, target)
    assert copy.read_bytes() != issued.read_bytes()
    assert verify_calibration(copy).digest == verify_calibration(issued).digest


def test_the_same_calibration_gives_the_same_bytes(issued, tmp_path):
    again = tmp_path / "again.h5"
    write_calibration(again, sample_calibration())
    assert again.read_bytes() == issued.read_bytes()


def test_negative_zero_is_written_as_zero(tmp_path):
    """SQLite has only one zero; what is put together again from its rows must have the same digest."""
    sample = sample_calibration()
    first, second = sample.baseline
    negative = replace(sample, scale=-0.0, baseline=(first, replace(second, y_mm=-0.0)))
    positive = replace(sample, scale=0.0)
    assert stamped(negative).digest == stamped(positive).digest
    write_calibration(tmp_path / "x.h5", negative)
    assert not np.signbit(read_calibration(tmp_path / "x.h5").scale)


def _with_large_arrays():
    """Like a real one in size: a Jacobian and a matrix of a hundred thousand numbers each."""
    sample = sample_calibration()
    problem = sample.reconstruction.problem
    count = 4000
    corners = np.arange(count)[:, None] + np.arange(3)
    angle = np.linspace(0.0, 40.0, count + 2)
    nodes = np.column_stack([angle * np.cos(angle), angle * np.sin(angle)])
    smooth = np.sin(np.arange(len(problem.reference))[:, None] + angle[:count] / 9)
    grown = replace(problem, mesh=Mesh(nodes, corners), jacobian=smooth)
    return replace(sample, reconstruction=replace(sample.reconstruction, problem=grown, matrix=smooth.T.copy()))


def test_large_arrays_are_compressed_and_come_back_to_the_bit(tmp_path):
    path, large = tmp_path / "large.h5", _with_large_arrays()
    assert write_calibration(path, large) == stamped(large).digest == _plain_digest(path)
    with h5py.File(path) as file:
        stored = {name: file[f"reconstruction/{name}"] for name in ("matrix", "jacobian")}
        assert {dataset.compression for dataset in stored.values()} == {"gzip"}
        assert all(dataset.id.get_storage_size() < dataset.nbytes for dataset in stored.values())
        assert file["identity/serial"].compression is None
    assert_same(read_calibration(path), stamped(large), "calibration")


def test_matrix_and_jacobian_in_single_precision_come_back_to_the_bit_and_take_less_room(tmp_path):
    double, path = _with_large_arrays(), tmp_path / "single.h5"
    single = replace(double, reconstruction=double.reconstruction.in_single_precision())
    write_calibration(tmp_path / "double.h5", double)
    assert write_calibration(path, single) == stamped(single).digest == _plain_digest(path)
    assert_same(read_calibration(path), stamped(single), "calibration")
    assert verify_calibration(path).schema_version == 3
    assert verify_calibration(tmp_path / "double.h5").schema_version == 2
    assert path.stat().st_size < 0.6 * (tmp_path / "double.h5").stat().st_size
    # What is not prepared again is the same record, however the rest is kept.
    assert stamped(single).record_digest == stamped(double).record_digest
    for name in ("matrix", "jacobian"):
        one, other = (
            made.reconstruction.matrix if name == "matrix" else made.reconstruction.problem.jacobian
            for made in (single, double)
        )
        assert np.linalg.norm(one - other) < 6e-8 * np.linalg.norm(other)


def test_reciprocal_rows_of_the_jacobian_are_kept_once(tmp_path):
    large = _with_large_arrays()
    problem = large.reconstruction.problem
    random = np.random.default_rng(3).standard_normal(problem.jacobian.shape)
    alike = random.copy()
    alike[len(alike) // 2 :] = alike[: len(alike) - len(alike) // 2]
    sizes = []
    for name, jacobian in (("random", random), ("alike", alike)):
        made = replace(large.reconstruction, problem=replace(problem, jacobian=jacobian)).in_single_precision()
        write_calibration(tmp_path / f"{name}.h5", replace(large, reconstruction=made))
        with h5py.File(tmp_path / f"{name}.h5") as file:
            sizes.append(file["reconstruction/jacobian"].id.get_storage_size())
    assert sizes[1] < 0.6 * sizes[0]


def test_a_matrix_worked_out_on_another_computer_changes_the_digest_but_not_that_of_the_record():
    sample = sample_calibration()
    rounded = replace(sample.reconstruction, matrix=np.nextafter(sample.reconstruction.matrix, np.inf))
    here, there = stamped(sample), stamped(replace(sample, reconstruction=rounded))
    assert here.record_digest == there.record_digest
    assert here.digest != there.digest


@pytest.mark.parametrize(
    "change",
    [
        {"scale": 1.0},
        {"relaxations": ()},
        {"noise_figure": None},
        {"against_stress": replace(sample_calibration().against_stress, covariance=None)},
        {"size_ratio": (0.5, 2.0)},
    ],
)
def test_a_calibration_changed_after_it_was_issued_is_not_written(tmp_path, change):
    issued = stamped(sample_calibration())
    with pytest.raises(CalibrationError, match="not what was issued"):
        write_calibration(tmp_path / "x.h5", replace(issued, **change))
    assert list(tmp_path.iterdir()) == []


def test_a_signal_with_two_units_is_refused(tmp_path):
    sample = sample_calibration()
    mixed = (*sample.relaxations[:2], replace(sample.relaxations[2], unit="V"))
    with pytest.raises(CalibrationError, match="conductance have several units: 1, V"):
        write_calibration(tmp_path / "x.h5", replace(sample, relaxations=mixed))


@pytest.mark.parametrize("signal", ["", "a/b", "../up"])
def test_a_signal_that_cannot_name_a_group_is_refused(tmp_path, signal):
    sample = sample_calibration()
    with pytest.raises(CalibrationError, match="letters, digits"):
        write_calibration(
            tmp_path / "x.h5", replace(sample, relaxations=(replace(sample.relaxations[0], signal=signal),))
        )


def test_a_number_read_with_plain_h5py_is_the_number(issued):
    with h5py.File(issued) as file:
        assert file["baseline_conductance/location"].asstr()[()].tolist() == ["L0", "L1"]
        value = file["baseline_conductance/value"][()]
        assert value[0] == 0.31
        assert np.isnan(value[1])
        assert file["identity/serial"].asstr()[()] == "S-001 ü"


# --- what is refused ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(issued, share):
    whole = issued.read_bytes()
    issued.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(CalibrationError, match=rf"{issued.name}.*(truncated|changed)"):
        read_calibration(issued)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("baseline_conductance/value", [0.32, np.nan]),
        ("identity/serial", "S-002"),
        ("validity/force", [0.0, 99.0]),
        ("sensor_type/electrodes/counterclockwise", True),
        ("settling/accepted", [9, 0]),
    ],
)
def test_an_edited_value_is_refused(issued, path, value):
    with h5py.File(issued, "r+") as file:
        file[path][...] = value
    with pytest.raises(CalibrationError, match="changed after it was issued"):
        read_calibration(issued)


def test_changed_units_are_refused(issued):
    with h5py.File(issued, "r+") as file:
        file["validity/force"].attrs["units"] = "kN"
    with pytest.raises(CalibrationError, match="changed after it was issued"):
        verify_calibration(issued)


def test_an_added_or_removed_dataset_is_refused(issued):
    with h5py.File(issued, "r+") as file:
        file.create_dataset("extra", data=1.0).attrs["units"] = "1"
    with pytest.raises(CalibrationError, match="changed after it was issued"):
        verify_calibration(issued)
    with h5py.File(issued, "r+") as file:
        del file["extra"]
        verify_calibration(issued)
        del file["image/mask"]
    with pytest.raises(CalibrationError, match="changed after it was issued"):
        verify_calibration(issued)


def test_a_missing_digest_is_refused(issued):
    with h5py.File(issued, "r+") as file:
        del file.attrs["digest"]
    with pytest.raises(CalibrationError, match="states no SHA-256"):
        verify_calibration(issued)


def test_a_future_version_is_refused_by_name(issued):
    with h5py.File(issued, "r+") as file:
        file.attrs["schema_version"] = np.int64(7)
    with pytest.raises(CalibrationError, match="version 7; this program knows versions up to 3"):
        read_calibration(issued)


@pytest.mark.parametrize("version", [np.int64(0), np.float64(1.0), "1"])
def test_a_version_that_never_was_is_refused(issued, version):
    with h5py.File(issued, "r+") as file:
        file.attrs["schema_version"] = version
    with pytest.raises(CalibrationError, match="version"):
        read_calibration(issued)


def test_another_hdf5_file_and_no_hdf5_file_are_refused(tmp_path):
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["x"] = 1.0
    with pytest.raises(CalibrationError, match="not a calibration"):
        read_calibration(other)
    text = tmp_path / "notes.txt"
    text.write_text("no HDF5 at all")
    with pytest.raises(CalibrationError, match="not a whole HDF5 file"):
        read_calibration(text)
    with pytest.raises(CalibrationError, match="no such file"):
        read_calibration(tmp_path / "absent.h5")
    with pytest.raises(CalibrationError, match="a folder or a device"):
        read_calibration(tmp_path)


@pytest.mark.parametrize("stated", [np.array([1, 2]), np.array(["cbsr-qa calibration"] * 2, dtype=object), 3.0])
def test_a_format_that_is_no_word_is_not_a_calibrations(issued, stated):
    with h5py.File(issued, "r+") as file:
        file.attrs["format"] = stated
    with pytest.raises(CalibrationError, match="not a calibration"):
        read_calibration(issued)


def test_what_is_stated_instead_of_a_digest_is_not_printed(issued):
    with h5py.File(issued, "r+") as file:
        file.attrs["digest"] = "\x1b[31mred"
    with pytest.raises(CalibrationError, match="states no SHA-256"):
        read_calibration(issued)


def test_names_within_names_come_to_an_end(issued):
    with h5py.File(issued, "r+") as file:
        inner = file.create_group("b0")
        for depth in range(1, 4):
            outer = file.create_group(f"b{depth}")
            for number in range(60):
                outer[f"x{number}"] = inner
            inner = outer
    with pytest.raises(CalibrationError, match="more than 10000 names"):
        read_calibration(issued)


@pytest.mark.parametrize("shape", [(1, 2), (2**26,)])
def test_texts_are_lists_and_not_millions(issued, shape):
    with h5py.File(issued, "r+") as file:
        del file["assumed"]
        texts = file.create_dataset("assumed", shape, dtype=h5py.string_dtype(), chunks=True)
        texts.attrs["units"] = "text"
    with pytest.raises(CalibrationError, match="assumed holds texts of the shape"):
        read_calibration(issued)


def test_control_characters_in_a_name_do_not_reach_the_terminal(issued):
    with h5py.File(issued, "r+") as file:
        file["force/\x1b[2J"] = np.complex128(1)
        file["force/\x1b[2J"].attrs["units"] = "1"
    with pytest.raises(CalibrationError) as caught:
        read_calibration(issued)
    assert "\x1b" not in caught.value.reason


def test_a_name_no_file_can_have_is_refused(tmp_path):
    with pytest.raises(CalibrationError, match="cannot be read: File name too long"):
        read_calibration(tmp_path / ("x" * 300))


def _forge(path: Path) -> None:
    """State the digest that the content now has, as somebody would who knows how."""
    digest = _plain_digest(path)
    with h5py.File(path, "r+") as file:
        file.attrs["digest"] = digest


def test_content_that_contradicts_itself_is_refused_even_with_a_fitting_digest(issued):
    with h5py.File(issued, "r+") as file:
        del file["baseline_conductance/x"]
        file.create_dataset("baseline_conductance/x", data=np.zeros(3)).attrs["units"] = "mm"
    _forge(issued)
    with pytest.raises(CalibrationError, match="contradicts itself"):
        read_calibration(issued)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("image/mask", None, "image/mask is missing"),
        ("image/mask", "0.85", "image/mask does not hold float64 numbers"),
        ("identity/serial", 3.0, "identity/serial is not a text"),
        ("image/noise_floor", [1.0, 2.0], "shape"),
        ("image/response", "sideways", "sideways"),
        ("validity/force", [1.0, 2.0, 3.0], "instead of two"),
        ("mesh/electrode_edge_counts", [1, 1], "the counts say 2"),
        ("reconstruction/matrix", [[1.0]], "does not fit"),
        ("relaxation/stress/number", [0], "not 0, 1, 2"),
        ("area_overlap/size_ratio", [1.0], "instead of two"),
    ],
)
def test_content_of_the_wrong_kind_is_named_even_with_a_fitting_digest(issued, path, value, said):
    with h5py.File(issued, "r+") as file:
        del file[path]
        if value is not None:
            file.create_dataset(path, data=value).attrs["units"] = "1"
    _forge(issued)
    with pytest.raises(CalibrationError, match=said):
        read_calibration(issued)


def test_links_out_of_the_file_are_not_followed(issued, tmp_path):
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["x"] = 1.0
    with h5py.File(issued, "r+") as file:
        del file["image/mask"]
        file["image/mask"] = h5py.ExternalLink(str(secret), "/x")
    with pytest.raises(CalibrationError, match="image/mask is a link"):
        read_calibration(issued)


def test_circular_groups_end(issued):
    with h5py.File(issued, "r+") as file:
        file["image/again"] = file["image"]
    with pytest.raises(CalibrationError, match="is a link"):
        read_calibration(issued)


def test_a_dataset_of_another_type_or_of_absurd_size_is_refused(issued):
    with h5py.File(issued, "r+") as file:
        file.create_dataset("huge", shape=(10**12,), dtype="f8", chunks=(1000,)).attrs["units"] = "1"
    with pytest.raises(CalibrationError, match="too large"):
        read_calibration(issued)
    with h5py.File(issued, "r+") as file:
        del file["huge"]
        file.create_dataset("odd", data=np.zeros(2, dtype="f2")).attrs["units"] = "1"
    with pytest.raises(CalibrationError, match="odd is of the type float16"):
        read_calibration(issued)


def test_a_matrix_prepared_for_another_sensor_type_is_not_written(tmp_path):
    mixed = replace(sample_calibration(), sensor_type=replace(sample_sensor_type(), name="disc-other"))
    with pytest.raises(CalibrationError, match=r"'disc-test'.*'disc-other'"):
        write_calibration(tmp_path / "mixed.h5", mixed)
    assert list(tmp_path.iterdir()) == []


# --- nothing half-written ------------------------------------------------------------------------------------


def test_a_failed_write_leaves_the_old_file_and_nothing_else(issued, monkeypatch):
    before = issued.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CalibrationError, match="No space left on device"):
        write_calibration(issued, sample_calibration())
    assert issued.read_bytes() == before
    assert list(issued.parent.iterdir()) == [issued]


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "calibrations").write_text("in the way")
    with pytest.raises(CalibrationError, match="cannot be written"):
        write_calibration(tmp_path / "calibrations" / "x.h5", sample_calibration())


def test_a_text_that_hdf5_cannot_hold_is_refused(tmp_path):
    with pytest.raises(CalibrationError, match="cannot be written"):
        write_calibration(tmp_path / "x.h5", replace(sample_calibration(), run="a\0b"))
    assert list(tmp_path.iterdir()) == []


def test_a_disk_without_room_for_it_is_said_and_leaves_nothing(tmp_path):
    """In a process of its own, whose files may not grow: HDF5 used to crash it where it could not close its file."""
    code = """
    import resource, sys
    from pathlib import Path
    from calibration_samples import sample_calibration
    from cbsr_qa.calibrate.file import write_calibration
    from cbsr_qa.domain.errors import CalibrationError
    calibration = sample_calibration()
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
    try:
        write_calibration(Path(sys.argv[1]), calibration)
    except CalibrationError as error:
        sys.stdout.write(error.reason)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), str(tmp_path / "c.h5")],
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "c.h5 cannot be written: File too large" in done.stdout
    assert list(tmp_path.iterdir()) == []
