"""Readings of one electrode that are noise in single presses, and sound ones beside an electrode."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_sheets import adjacent_pairs, pressed_sheet

from cbsr_qa.calibration.place.faulty import noisy_readings
from cbsr_qa.calibration.presses.learning import learn_presses

PAIRS = adjacent_pairs(16)
OF_TWO = (PAIRS == 2).any(axis=1)


@pytest.fixture
def presses():
    """Features (60, m) and their errors of variance one; the first press errs by 30 at electrode 2."""
    random = np.random.default_rng(1)
    errors = random.standard_normal((60, len(PAIRS)))
    errors[0, OF_TWO] += 30 * random.standard_normal(OF_TWO.sum())
    return 50 * random.standard_normal(errors.shape) + errors, errors


def found(presses, modelled=None):
    missing = np.zeros(presses[0].shape, dtype=bool)
    return noisy_readings(PAIRS, *presses, missing, modelled or no_model)


def no_model(rows):
    return np.full((len(rows), len(PAIRS)), np.nan)


def test_readings_that_others_do_not_let_expect_are_noise(presses):
    noisy = found(presses)
    assert np.flatnonzero(noisy.any(axis=1)).tolist() == [0]
    assert np.array_equal(noisy[0], OF_TWO)


def test_readings_that_the_modelled_sheet_lets_expect_are_sound(presses):
    features, _ = presses
    other = np.random.default_rng(2).standard_normal(features.shape)
    beside = np.where(OF_TWO, features + other, features)
    assert not found(presses, lambda rows: 3 * beside[rows]).any()
    unlike = np.where(OF_TWO, 50 * other, features)
    assert found(presses, lambda rows: unlike[rows])[0].any()


def test_a_model_that_misses_the_other_readings_too_does_not_decide(presses):
    features, _ = presses
    poor = np.where(OF_TWO, features, features + 50 * np.random.default_rng(3).standard_normal(features.shape))
    assert found(presses, lambda rows: poor[rows])[0].any()


def test_without_a_model_readings_that_err_as_usual_for_their_size_are_sound(presses):
    """In every other press one electrode's readings are expected to change six times as much, and err so."""
    features, errors = presses
    random = np.random.default_rng(4)
    for press in range(0, 60, 2):
        group = ((press // 2 + 2) % 16 == PAIRS).any(axis=1)
        expected = 300 * random.standard_normal(group.sum())
        errors[press, group] = 0.1 * expected * random.standard_normal(group.sum())
        features[press, group] = expected + errors[press, group]
    assert not found((features, errors)).any()
    errors[1], features[1] = errors[0], features[0] - 9 * (features[0] - errors[0]) / 10
    assert np.flatnonzero(found((features, errors)).any(axis=1)).tolist() == [1]


def test_missing_readings_accuse_nobody(presses):
    missing = np.zeros(presses[0].shape, dtype=bool)
    missing[0] = OF_TWO
    assert not noisy_readings(PAIRS, *presses, missing, no_model).any()


@pytest.mark.rest
def test_presses_up_to_the_electrodes_are_used_whole_and_noise_is_found_there():
    """Within 62 mm of the centre of 73 mm, heads reach the ring of electrodes; errors there grow as the response."""
    sheet, random = (
        pressed_sheet(100, seed=1, noise=0.05, reach=62 / 73, pairs=adjacent_pairs()),
        np.random.default_rng(2),
    )
    assert not any("noise" in words for words in learn_presses(sheet.labelled()).place.warnings)
    changes = sheet.changes.copy()
    spoiled = random.choice(100, 5, replace=False)
    for row in spoiled:
        group = (sheet.pairs == random.integers(16)).any(axis=1)
        changes[row, group] = 20 * np.median(np.abs(changes)) * random.standard_normal(group.sum())
    (words,) = [
        words
        for words in learn_presses(replace(sheet, changes=changes).labelled()).place.warnings
        if "noise" in words
    ]
    assert int(words.split("left out: ")[1].split(";")[0]) in (4, 5)
