"""The symmetry of a pattern of readings, and what is taken for a spike."""

import numpy as np
import pytest
from pressed_sheets import adjacent_pairs, opposite_pairs, pressed_sheet, readings, round_sensor

from cbsr_qa.calibration.place.features import (
    ceilings_of,
    matern_and_slope,
    pattern_turns,
    spikes_among,
    spikes_in,
    turn_by,
)


@pytest.mark.parametrize(
    "pairs", [adjacent_pairs(), opposite_pairs(), adjacent_pairs(8)], ids=["adjacent", "opposite", "8"]
)
def test_a_ring_scan_stays_itself_under_all_turns_and_mirrors(pairs):
    electrodes = int(pairs.max()) + 1
    turns = pattern_turns(pairs, electrodes)
    assert len(turns) == 2 * electrodes
    assert np.allclose(turns.turns[0], np.eye(2))
    assert (turns.permuted[0] == np.arange(len(pairs))).all()
    x = np.random.default_rng(0).standard_normal((3, len(pairs)))
    for number in range(len(turns)):
        assert np.array_equal(turns.turn_back(turns.turn_forth(x, number), number), x)
        # The turns are a group: a turn after a turn is another one, of readings as of places.
        after = turns.turns[number] @ turns.turns[5]
        other = int(np.abs(turns.turns - after).sum(axis=(1, 2)).argmin())
        assert np.allclose(turns.turns[other], after)
        assert np.array_equal(turns.turn_forth(turns.turn_forth(x, 5), number), turns.turn_forth(x, other))


def test_a_pattern_without_symmetry_has_the_identity_alone():
    pairs = opposite_pairs()[np.random.default_rng(1).permutation(192)[:40]]
    assert len(pattern_turns(pairs, 16)) == 1


def test_one_polarity_is_enough():
    pairs = np.array([pair for pair in opposite_pairs().tolist() if pair[0] < 8])
    turns = pattern_turns(pairs, 16)
    assert len(turns) == 32
    assert (turns.signs == -1).any()


def test_readings_turn_as_the_sheet_does():
    pairs, angle = opposite_pairs(), 2 * np.pi * 3 / 16
    place = np.array([[20.0, 7.0]])
    for mirrored in (False, True):
        turn = turn_by(angle, mirrored=mirrored)
        turns = pattern_turns(pairs, 16)
        number = int(np.abs(turns.turns - turn).sum(axis=(1, 2)).argmin())
        loaded, unloaded = readings(round_sensor(), pairs, np.concatenate([place, place @ turn.T]), contrast=0.2)
        first, second = loaded - unloaded
        # To the accuracy of the mesh, which does not turn by three electrodes into itself.
        assert turns.turn_forth(first[None], number)[0] == pytest.approx(second, abs=2e-3 * np.abs(second).max())


def test_slope_of_the_covariance_is_its_derivative():
    squared, step = np.array([0.01, 0.5, 3.0]), 1e-6
    numeric = (matern_and_slope(squared + step)[0] - matern_and_slope(squared - step)[0]) / (2 * step)
    assert matern_and_slope(squared)[1] == pytest.approx(numeric, rel=1e-6)


def test_a_press_far_stronger_than_those_that_calibrated_is_no_spike():
    changes = pressed_sheet(60).changes
    ceiling = ceilings_of(changes)
    one = 20 * changes[:1].copy()
    one[0, 7] = 100 * ceiling[7]
    for frame in (20 * changes, changes):
        assert spikes_in(frame, ceiling).mean() < 2e-3
    assert spikes_in(one, ceiling)[0].nonzero()[0].tolist() == [7]


def test_spikes_are_found_that_are_a_tenth_of_some_readings_of_few_presses():
    sound, random = pressed_sheet(39, noise=0.05).changes, np.random.default_rng(3)
    spikes = random.random(sound.shape) < 0.05
    height = 100 * np.median(np.abs(sound)) * random.choice([-1.0, 1.0], spikes.shape)
    found = spikes_among(np.where(spikes, height, sound))
    assert found[spikes].mean() > 0.95  # by quantiles of 90 %: 0.8
    assert found[~spikes].mean() < 1e-3
    assert not spikes_among(sound).any()
