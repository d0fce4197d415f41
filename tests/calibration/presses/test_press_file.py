"""The file of a calibration from labelled presses: kept whole, and content that no place follows from is refused."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_samples import edited
from pressed_sheets import issued_from_presses

from cbsr_qa.calibration.file.entries import decode, encode
from cbsr_qa.calibration.file.hdf5 import (
    read_calibration,
    read_issued,
    stamp,
    verify_calibration_file,
    write_calibration,
)
from cbsr_qa.calibration.presses.learning import noise_size
from cbsr_qa.domain.errors import LAST_UNRELEASED, CalibrationError


@pytest.fixture(scope="module")
def issued():
    return issued_from_presses()


def test_what_is_written_is_read(issued, tmp_path):
    path = tmp_path / "presses.h5"
    write_calibration(path, issued)
    back = read_issued(path)
    assert back.digest == issued.digest
    assert back.registration == issued.registration
    assert repr(back) == repr(issued)
    np.testing.assert_array_equal(back.pairs, issued.pairs)
    assert (back.drive, back.measure) == (issued.drive, issued.measure)
    assert verify_calibration_file(path).schema_version == 4
    with pytest.raises(CalibrationError, match="not issued by a run"):
        read_calibration(path)
    with pytest.raises(CalibrationError, match="is not what was issued"):
        write_calibration(tmp_path / "other.h5", replace(issued, used=11))


def test_what_knows_no_force_comes_back_and_what_has_no_order_of_a_frame_is_refused(issued, tmp_path):
    write_calibration(tmp_path / "none.h5", stamp(replace(issued, force=None)))
    assert read_issued(tmp_path / "none.h5").force is None
    write_calibration(tmp_path / "force.h5", issued)
    back = read_issued(tmp_path / "force.h5").force
    assert back.error == issued.force.error
    np.testing.assert_array_equal(back.strength, issued.force.strength)
    write_calibration(tmp_path / "bare.h5", stamp(replace(issued, drive=())))
    with pytest.raises(CalibrationError, match="readings/drive or readings/measure is empty"):
        read_issued(tmp_path / "bare.h5")


@pytest.mark.parametrize("version", [1, 2, 3])
def test_a_file_of_before_the_first_version_is_refused(issued, tmp_path, version):
    path = tmp_path / "presses.h5"
    write_calibration(path, issued)
    with edited(path) as file:
        file.attrs["schema_version"] = np.int64(version)
    with pytest.raises(CalibrationError, match=rf"schema version {version}, from before version 0\.1\.0") as caught:
        read_issued(path)
    assert LAST_UNRELEASED in caught.value.remedy


def test_frames_without_a_load_are_not_larger_than_the_noise_of_one():
    random, noise = np.random.default_rng(5), np.linspace(0.1, 2.0, 192)
    sizes = np.sqrt(((noise * random.standard_normal((4000, 192))) ** 2).mean(axis=1))
    assert (sizes > noise_size(noise)).mean() < 0.005
    assert np.median(sizes) > 0.8 * noise_size(noise)


@pytest.mark.parametrize(
    ("path", "change", "why"),
    [
        ("readings/pairs", lambda value: value + 100, "names an electrode other than 0 to 15"),
        ("registration/scale", lambda value: value * 0, "is not positive"),
        ("place/scaling/ceiling", lambda value: value[1:], "191 readings, readings/pairs of 192"),
        ("place/turns/permuted", lambda value: value + 1, "names a reading other than 0 to 191"),
        ("place/mixture/quantiles", lambda value: value[::-1].copy(), "are not positive and rising"),
        ("place/templates/whitening", lambda value: value * np.nan, "not a finite number"),
        ("force/values", lambda value: -value, "force/values are not all positive"),
        ("force/values", lambda value: 0 * value + 1, "force/values are all alike"),
        ("force/strength", lambda value: value[1:], "does not fit 11 presses"),
        ("force/quantiles", lambda value: 0 * value, "force/quantiles are not positive and rising"),
        ("place/axes", lambda value: value + 5, "-1 to 1 are allowed"),
    ],
)
def test_content_that_no_place_follows_from_is_refused(issued, path, change, why):
    entries = dict(encode(issued))
    entries[path] = replace(entries[path], value=np.asarray(change(entries[path].value)))
    with pytest.raises(CalibrationError, match=why):
        decode(entries)
