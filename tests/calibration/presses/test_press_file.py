"""The file of a calibration from labelled presses: kept whole, and content that no place follows from is refused."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_sheets import pressed_sheet

from cbsr_qa.calibration.file import decode, encode, read_calibration, read_issued, write_calibration
from cbsr_qa.calibration.presses import Identity, issue_from_presses, learn_presses
from cbsr_qa.domain import CalibrationError


@pytest.fixture(scope="module")
def issued():
    labelled = pressed_sheet(12, noise=0.05).labelled()
    return issue_from_presses(Identity("id", "now", ()), labelled, learn_presses(labelled))


def test_what_is_written_is_read(issued, tmp_path):
    path = tmp_path / "presses.h5"
    write_calibration(path, issued)
    back = read_issued(path)
    assert back.digest == issued.digest
    assert back.registration == issued.registration
    assert repr(back) == repr(issued)
    np.testing.assert_array_equal(back.pairs, issued.pairs)
    with pytest.raises(CalibrationError, match="not issued by a run"):
        read_calibration(path)
    with pytest.raises(CalibrationError, match="is not what was issued"):
        write_calibration(tmp_path / "other.h5", replace(issued, used=11))


@pytest.mark.parametrize(
    ("path", "change", "why"),
    [
        ("readings/pairs", lambda value: value + 100, "names an electrode other than 0 to 15"),
        ("registration/scale", lambda value: value * 0, "is not positive"),
        ("place/scaling/ceiling", lambda value: value[1:], "191 readings, readings/pairs of 192"),
        ("place/turns/permuted", lambda value: value + 1, "names a reading other than 0 to 191"),
        ("place/mixture/quantiles", lambda value: value[::-1].copy(), "are not positive and rising"),
        ("place/templates/whitening", lambda value: value * np.nan, "not a finite number"),
        ("place/axes", lambda value: value + 5, "-1 to 1 are allowed"),
    ],
)
def test_content_that_no_place_follows_from_is_refused(issued, path, change, why):
    entries = dict(encode(issued))
    entries[path] = replace(entries[path], value=np.asarray(change(entries[path].value)))
    with pytest.raises(CalibrationError, match=why):
        decode(entries)
