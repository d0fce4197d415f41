"""The calibration file: exact round trip, its digest, and what is not written."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from calibration_samples import (
    assert_same,
    plain_digest,
    sample_calibration,
    sample_sensor_type,
    sparse_calibration,
)

from cbsr_qa.calibration.file.hdf5 import read_calibration, stamp, verify_calibration_file, write_calibration
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.kept import as_filed, round_to_steps
from cbsr_qa.domain.sensor.mesh import Mesh


@pytest.mark.parametrize("make", [sample_calibration, sparse_calibration])
def test_every_field_comes_back_exactly(tmp_path, make):
    path = tmp_path / "sensor.h5"
    write_calibration(path, make())
    assert_same(read_calibration(path), stamp(make()), "calibration")


@pytest.mark.parametrize(("name", "criterion"), [("λ", "gcv"), ("μ", ""), ("λ", "")])
def test_name_and_criterion_come_back_whichever_is_there(tmp_path, name, criterion):
    sample = sample_calibration()
    choice = replace(sample.reconstruction.choice, name=name, criterion=criterion)
    made = replace(sample, reconstruction=replace(sample.reconstruction, choice=choice))
    write_calibration(tmp_path / "x.h5", made)
    assert_same(read_calibration(tmp_path / "x.h5"), stamp(made), "calibration")


def test_relaxations_of_a_signal_are_in_the_unit_of_its_traces(issued):
    """The units of all other datasets are those of the page that describes the file."""
    with h5py.File(issued) as file:
        for signal, units in (("conductance", "1"), ("stress", "kPa")):
            for name in ("amplitudes", "settling_band"):
                assert file[f"relaxation/{signal}/{name}"].attrs["units"] == units


def test_the_digest_does_not_depend_on_the_order_of_writing(issued, tmp_path):
    copy = tmp_path / "copy.h5"
    with h5py.File(issued) as source, h5py.File(copy, "w", libver="latest", track_order=True) as target:
        for name, value in source.attrs.items():
            target.attrs[name] = value
        for name in reversed(list(source)):
            source.copy(name, target)
    assert copy.read_bytes() != issued.read_bytes()
    assert verify_calibration_file(copy).digest == verify_calibration_file(issued).digest


def test_negative_zero_is_written_as_zero(tmp_path):
    """SQLite has only one zero; what is put together again from its rows must have the same digest."""
    sample = sample_calibration()
    first, second = sample.baseline
    negative = replace(sample, scale=-0.0, baseline=(first, replace(second, y_mm=-0.0)))
    positive = replace(sample, scale=0.0)
    assert stamp(negative).digest == stamp(positive).digest
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


def _in_single_precision(calibration):
    made = calibration.reconstruction
    jacobian, matrix = (values.astype(np.float32).astype(float) for values in (made.problem.jacobian, made.matrix))
    single = replace(made, matrix=matrix, problem=replace(made.problem, jacobian=jacobian))
    return replace(calibration, reconstruction=single)


def test_matrix_and_jacobian_are_compressed_and_come_back_to_the_bit_in_any_precision(tmp_path):
    """Values in steps take the least room."""
    double = _with_large_arrays()
    rounded = replace(double, reconstruction=as_filed(double.reconstruction))
    sizes = []
    for name, made in (("double", double), ("single", _in_single_precision(double)), ("steps", rounded)):
        path = tmp_path / f"{name}.h5"
        assert write_calibration(path, made) == stamp(made).digest == plain_digest(path)
        assert_same(read_calibration(path), stamp(made), "calibration")
        # What is not prepared again is the same record, however the rest is kept.
        assert stamp(made).record_digest == stamp(double).record_digest
        sizes.append(path.stat().st_size)
    with h5py.File(tmp_path / "double.h5") as file:
        stored = [file[f"reconstruction/{name}"] for name in ("matrix_columns", "jacobian")]
        assert [dataset.compression for dataset in stored] == ["gzip"] * 2
        assert all(dataset.id.get_storage_size() < dataset.nbytes for dataset in stored)
        assert file["identity/serial"].compression is None
    assert sizes[1] < 0.6 * sizes[0]
    assert sizes[2] < 0.6 * sizes[1]


def test_what_reciprocal_readings_share_takes_room_once(tmp_path):
    large = _with_large_arrays()
    problem = large.reconstruction.problem
    random = np.random.default_rng(3).standard_normal(problem.jacobian.shape)
    alike = random.copy()
    alike[len(alike) // 2 :] = alike[: len(alike) - len(alike) // 2]
    sizes = []
    for name, values in (("random", random), ("alike", alike)):
        changed = replace(large.reconstruction, problem=replace(problem, jacobian=values), matrix=values.T.copy())
        write_calibration(tmp_path / f"{name}.h5", replace(large, reconstruction=as_filed(changed)))
        with h5py.File(tmp_path / f"{name}.h5") as file:
            of = file["reconstruction"]
            sizes.append([of[one].id.get_storage_size() for one in ("jacobian", "matrix_columns")])
    assert (np.array(sizes[1]) < 0.6 * np.array(sizes[0])).all()


@pytest.mark.parametrize("seed", range(20))
def test_values_in_steps_are_near_and_stay_when_rounded_again(seed):
    random = np.random.default_rng(seed)
    values = random.standard_normal((30, 4)) * 10.0 ** random.integers(-12, 12)
    values[0, 0] = 2.0 ** random.integers(-40, 40) * (1 - 1e-6)  # rounded up to where steps are twice as large
    largest, steps = np.abs(values).max(), 2**12
    rounded = round_to_steps(values, steps)
    assert np.abs(rounded - values).max() <= 0.5 * (1 + 1 / steps) * largest / steps
    np.testing.assert_array_equal(round_to_steps(rounded, steps), rounded)
    np.testing.assert_array_equal(rounded.astype(np.float32), rounded)


@pytest.mark.parametrize("size", [0.0, 1e-320, 2e-305, 1e308, np.inf, np.nan])
def test_values_of_any_size_are_rounded_or_stay(size):
    """A step smaller than any normal number was divided by."""
    values = size * np.array([1.0, 0.3])
    np.testing.assert_allclose(round_to_steps(values, 2**12), values, rtol=2**-12)
    assert round_to_steps(np.zeros((0, 3)), 16).shape == (0, 3)


_ISSUED = stamp(sample_calibration())
_FIRST, *_OTHERS, _LAST = _ISSUED.relaxations
_UNWRITABLE = {
    **{
        f"another {name}": (replace(_ISSUED, **{name: value}), "not what was issued")
        for name, value in {
            "scale": 1.0,
            "relaxations": (),
            "noise_figure": None,
            "against_stress": replace(_ISSUED.against_stress, covariance=None),
            "size_ratio": (0.5, 2.0),
        }.items()
    },
    "two units": (
        replace(sample_calibration(), relaxations=(_FIRST, *_OTHERS, replace(_LAST, unit="V"))),
        "conductance have several units: 1, V",
    ),
    **{
        f"signal {name!r}": (
            replace(sample_calibration(), relaxations=(replace(_FIRST, signal=name),)),
            "letters, digits",
        )
        for name in ("", "a/b", "../up")
    },
    "another sensor type": (
        replace(sample_calibration(), sensor_type=replace(sample_sensor_type(), name="disc-other")),
        r"'disc-test'.*'disc-other'",
    ),
    "a text that HDF5 cannot hold": (replace(sample_calibration(), run="a\0b"), "cannot be written"),
}


@pytest.mark.parametrize("what", _UNWRITABLE)
def test_what_is_unsound_is_not_written_and_leaves_nothing(tmp_path, what):
    calibration, said = _UNWRITABLE[what]
    with pytest.raises(CalibrationError, match=said):
        write_calibration(tmp_path / "x.h5", calibration)
    assert list(tmp_path.iterdir()) == []


def test_a_number_read_with_plain_h5py_is_the_number(issued):
    with h5py.File(issued) as file:
        assert file["baseline_conductance/location"].asstr()[()].tolist() == ["L0", "L1"]
        value = file["baseline_conductance/value"][()]
        assert value[0] == 0.31
        assert np.isnan(value[1])
        assert file["identity/serial"].asstr()[()] == "S-001 ü"
