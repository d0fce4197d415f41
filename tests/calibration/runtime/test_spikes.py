"""Spikes in single frames of a stream: one reading far from its reciprocal does not move a force."""

import numpy as np
import pytest
from force_calibration import NOISE_V, force_calibration, frames

from cbsr_qa.calibration import Calibration, Flag

PLACES = np.array([(0.0, 0.0), (5.0, 7.0), (-20.3, 10.1), (25.0, -12.4), (-3.3, -31.0), (17.0, 30.5)])
FORCES = np.array([1.2, 2.0, 3.0, 4.5, 5.4, 1.9])


@pytest.fixture(scope="module")
def calibration():
    return Calibration(force_calibration())


@pytest.mark.parametrize("size", [-1000.0, -0.01, 0.01, 0.3, 1e4])
def test_a_spike_is_flagged_and_does_not_move_the_force(calibration, size):
    clean = frames(PLACES, FORCES)
    alone = calibration.force(clean)
    spiked, random = clean.copy(), np.random.default_rng(3)
    readings = np.argwhere(calibration.issued.reconstruction.problem.used)[random.choice(208, len(PLACES))]
    for frame, (drive, measure) in enumerate(readings):
        spiked[frame, drive, measure] += size
    for found in (calibration.force(spiked), calibration.force(spiked, place_mm=PLACES)):
        assert (found.flags & Flag.SPIKE != 0).all()
        assert not (found.flags & (Flag.MORE_THAN_ONE | Flag.OTHER_SENSOR)).any()
    found = calibration.force(spiked)
    # One of 104 rows counts a single reading twice: less than a tenth of the errors that were there.
    assert np.abs(found.force_N - alone.force_N) == pytest.approx(0, abs=0.5 * alone.stderr_N.max())
    assert np.hypot(*(found.place_mm - PLACES).T).max() < 5 * alone.place_stderr_mm.max()
    assert all(
        several.flags & Flag.SPIKE and len(several.loads.force_N) == 1 for several in calibration.forces(spiked)
    )


@pytest.mark.parametrize("noise", [1.0, 5.0])
def test_no_clean_frame_has_a_spike(calibration, noise):
    places = np.repeat(PLACES, 200, axis=0)
    found = calibration.force(frames(places, np.repeat(FORCES, 200), noise * NOISE_V))
    assert not (found.flags & Flag.SPIKE).any()


def test_a_whole_row_that_jumps_is_no_spike_but_no_load_either(calibration):
    jumped = frames(PLACES, FORCES)
    jumped[:, 4] += 0.3
    flags = calibration.force(jumped).flags
    assert not (flags & Flag.SPIKE).any()
    assert (flags & (Flag.MORE_THAN_ONE | Flag.OTHER_SENSOR) != 0).all()
