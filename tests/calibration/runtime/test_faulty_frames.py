"""Faults of a front end in single frames: each is named, its readings are left out, and places stay within bounds."""

import numpy as np
import pytest
from force_calibration import NOISE_V, SCALE, force_calibration, frames
from stored_runs import SENSOR_TYPE
from tiers import rest_but

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.calibration.runtime.tracking import ForceStream
from cbsr_qa.eit.estimate.readings import load_model

COUNT = 60
NAMES = Flag.DEAD_PAIR | Flag.OPEN_ELECTRODE | Flag.SATURATED | Flag.OFFSET | Flag.MISSING


@pytest.fixture(scope="module")
def calibration():
    return Calibration(force_calibration())


@pytest.fixture(scope="module")
def pressed():
    random = np.random.default_rng(5)
    far, angle = 34 * np.sqrt(random.uniform(size=COUNT)), random.uniform(0, 2 * np.pi, COUNT)
    places = np.column_stack([far * np.cos(angle), far * np.sin(angle)])
    force_N = random.uniform(1.2, 5.4, COUNT)
    return places, force_N, frames(places, force_N)


def located(calibration, pressed, faulty, flag, *, within_mm, least=COUNT):
    """Check that every frame has this flag and no other, and that places and forces are as far off as they state."""
    places, force_N, _ = pressed
    found = calibration.force(faulty)
    assert (found.flags == flag).sum() >= least
    seen = found.flags == flag
    off_mm = np.hypot(*(found.place_mm - places).T)[seen]
    assert off_mm.mean() < within_mm
    assert (off_mm**2 / found.place_stderr_mm[seen] ** 2).mean() / 2 < 1.6
    assert np.std((found.force_N - force_N)[seen] / found.stderr_N[seen]) < 1.4
    several = calibration.forces(faulty[:3])
    assert [each.flags & NAMES for each in several] == [flag] * 3


def opened(clean, electrodes, *, measured=True):
    faulty, random = clean.copy(), np.random.default_rng(1)
    for frame, some in enumerate(electrodes):
        for pair in {(each - side) % 16 for each in some for side in (0, 1)}:
            faulty[frame, pair] = NOISE_V * random.standard_normal(16)
            if measured:
                faulty[frame, :, pair] = NOISE_V * random.standard_normal(16)
    return faulty


def test_clean_frames_have_none_of_the_faults(calibration, pressed):
    places, _, clean = pressed
    unloaded = frames(np.zeros((300, 2)), np.zeros(300), seed=4)
    heavy = frames(places, np.full(COUNT, 8.0))
    both = clean + heavy[::-1] - SCALE * load_model(SENSOR_TYPE).solve_unloaded()
    for seen in (clean, unloaded, heavy, both):
        assert not (calibration.force(seen).flags & NAMES).any()
        assert not any(each.flags & NAMES for each in calibration.forces(seen[:20]))


def _weak_drive(share):
    def spoil(frames):
        dead = np.arange(COUNT) % 16
        frames[np.arange(COUNT), dead] *= share
        frames[np.arange(COUNT), dead, dead] *= -1  # its own reading is wrapped

    return spoil


def _weak_pair(frames):
    frames[:, :, 9] *= 0.2


def _two_weak_drives(frames):
    frames[:, [3, 7]] *= 0.2


_SPOILT = {
    "a twentieth of a drive": _weak_drive(0.05),
    "a fifth of a drive": _weak_drive(0.2),
    "three tenths of a drive": _weak_drive(0.3),
    "a fifth of a pair": _weak_pair,
    "a fifth of two drives": _two_weak_drives,
}


@pytest.mark.parametrize("what", rest_but({"three tenths of a drive", "a fifth of a pair"}, _SPOILT))
def test_pairs_that_hardly_drive_or_measure_are_named_and_no_sound_ones(calibration, pressed, what):
    """A drive's column replaces its row. The share that is hardest to tell from a sound one is in ``make test``."""
    faulty = pressed[2].copy()
    _SPOILT[what](faulty)
    located(calibration, pressed, faulty, Flag.DEAD_PAIR, within_mm=0.5)


@pytest.mark.parametrize(("count", "within_mm"), rest_but({1, 4}, [(1, 0.6), (2, 0.8), (3, 1.2), (4, 2.0)]))
def test_open_electrodes_are_named_and_errors_grow_with_their_number(calibration, pressed, count, within_mm):
    random = np.random.default_rng(2)
    electrodes = [random.choice(16, count, replace=False) for _ in range(4)] * (COUNT // 4)
    faulty = opened(pressed[2], electrodes)
    # Few readings may not tell a weak load from none.
    located(calibration, pressed, faulty, Flag.OPEN_ELECTRODE, within_mm=within_mm, least=0.9 * COUNT)


def test_an_open_electrode_is_named_where_the_voltmeter_still_reads_its_contact(calibration, pressed):
    faulty = opened(pressed[2], [[each % 16] for each in range(COUNT)], measured=False)
    located(calibration, pressed, faulty, Flag.OPEN_ELECTRODE, within_mm=0.6)


@pytest.mark.parametrize("share", rest_but({0.3}, [0.05, 0.3]))
def test_readings_that_are_missing_are_left_out_and_the_errors_of_the_rest_hold(calibration, pressed, share):
    frames = pressed[2].copy()
    frames[np.random.default_rng(8).random(frames.shape) < share] = np.nan
    located(calibration, pressed, frames, Flag.MISSING, within_mm=0.6)
    found, whole = calibration.force(frames), calibration.force(pressed[2])
    assert np.isfinite(found.force_N).all()
    assert (found.place_stderr_mm > whole.place_stderr_mm).mean() > 0.9


def test_a_sheet_with_too_few_electrodes_gives_no_number(calibration, pressed):
    found = calibration.force(opened(pressed[2][:5], [[0, 2, 4, 6, 8, 10, 12]] * 5))
    assert (found.flags & (Flag.UNREADABLE | Flag.OTHER_SENSOR) != 0).all()
    assert np.isnan(found.force_N).all()


def test_clipped_readings_are_named_and_left_out(calibration, pressed):
    located(calibration, pressed, np.clip(pressed[2], -0.25, np.inf), Flag.SATURATED, within_mm=0.8)


@pytest.mark.parametrize("size", [5, 100, 3000])
def test_one_offset_on_all_readings_is_named_and_taken_out(calibration, pressed, size):
    sign = np.where(np.arange(COUNT) % 2, 1.0, -1.0)[:, None, None]
    located(calibration, pressed, pressed[2] + sign * size * NOISE_V, Flag.OFFSET, within_mm=0.5)
    unloaded = frames(np.zeros((30, 2)), np.zeros(30)) + size * NOISE_V
    assert (calibration.force(unloaded).flags == Flag.OFFSET | Flag.NOT_DETECTED).all()


def test_faults_of_one_batch_are_told_apart_and_keep_their_order(calibration, pressed):
    places, _, clean = pressed
    mixed = clean[:6].copy()
    mixed[1, 4] *= 0.2
    mixed[2] += 50 * NOISE_V
    mixed[3:4] = opened(mixed[3:4], [[7]])
    mixed[4, 4] *= 0.2
    mixed[4] += 50 * NOISE_V
    found = calibration.force(mixed, place_mm=places[:6])
    assert found.flags.tolist() == [
        0,
        Flag.DEAD_PAIR,
        Flag.OFFSET,
        Flag.OPEN_ELECTRODE,
        Flag.DEAD_PAIR | Flag.OFFSET,
        0,
    ]
    np.testing.assert_allclose(found.place_mm, places[:6])
    assert np.abs(found.force_N - pressed[1][:6]).max() < 4 * found.stderr_N.max()


def test_a_stream_goes_on_through_faults(calibration):
    """A load is followed while an offset sets in at 10 s and a drive dies at 20 s."""
    stream, place, told = ForceStream(calibration), (12.0, -8.0), {}
    seen = frames([place] * 30, np.full(30, 3.0))
    seen[:3] = frames([place] * 3, np.zeros(3))
    seen[10:] += 40 * NOISE_V
    seen[20:, 5] *= 0.2
    for time_s, frame in enumerate(seen):
        loads = stream.update(float(time_s), frame)
        told[time_s] = stream.flags
        assert len(loads) == (time_s >= 3)
        if loads:
            assert np.hypot(*np.subtract(loads[0].place_mm, place)) < 1.0
            assert abs(loads[0].force_N - 3.0) < 0.5
    assert {time_s: flag for time_s, flag in told.items() if flag} == {
        10: Flag.OFFSET,
        **dict.fromkeys(range(20, 30), Flag.DEAD_PAIR),
    }


# --- spikes: one reading far from its reciprocal ---

PLACES = np.array([(0.0, 0.0), (5.0, 7.0), (-20.3, 10.1), (25.0, -12.4), (-3.3, -31.0), (17.0, 30.5)])
FORCES = np.array([1.2, 2.0, 3.0, 4.5, 5.4, 1.9])


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
