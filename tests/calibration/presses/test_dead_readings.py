"""Readings that tell nothing of the press are found, named and left out; those of a sound sheet are not."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_sheets import adjacent_pairs, opposite_pairs, pressed_sheet, some

from cbsr_qa.calibration.place import PlaceEstimator
from cbsr_qa.calibration.presses.dead_readings import find_dead_readings
from cbsr_qa.calibration.presses.issue import learn_presses


def without_contact(pressed, electrode, *, common, noise=20.0):
    """The readings of one electrode replaced by noise, each its own or the same in all of them."""
    random, of = np.random.default_rng(5), (pressed.pairs == electrode).any(axis=1)
    changes = pressed.changes.copy()
    shape = (len(changes), 1 if common else of.sum())
    changes[:, of] = noise * np.median(np.abs(changes)) * random.standard_normal(shape)
    return replace(pressed, changes=changes)


@pytest.mark.parametrize("pairs", [opposite_pairs(), adjacent_pairs()])
@pytest.mark.parametrize("common", [False, True])
def test_an_electrode_without_contact_is_found(pairs, common):
    pressed = pressed_sheet(60, pairs=pairs, noise=0.3)
    sound = find_dead_readings(pairs, pressed.changes, pressed.labels_mm)
    assert not sound.findings
    assert sound.dead.mean() < 1e-3
    spoilt = without_contact(pressed, 5, common=common)
    found = find_dead_readings(pairs, spoilt.changes, spoilt.labels_mm)
    np.testing.assert_array_equal(found.dead.all(axis=0), (pairs == 5).any(axis=1))
    assert len(found.findings) == 1
    assert found.findings[0].startswith("electrode 5 is dead")


def test_spikes_do_not_make_a_sheet_a_foreign_one():
    pressed, random = pressed_sheet(140, noise=0.05), np.random.default_rng(8)
    spikes = random.random(pressed.changes.shape) < 0.05
    height = 100 * np.median(np.abs(pressed.changes)) * random.choice([-1.0, 1.0], spikes.shape)
    spiky = replace(pressed, changes=np.where(spikes, height, pressed.changes))
    found = find_dead_readings(pressed.pairs, spiky.changes, spiky.labels_mm)
    assert found.dead[spikes].mean() > 0.98
    assert found.dead[~spikes].mean() < 0.005
    learned = learn_presses(some(spiky, np.arange(40)).labelled())
    assert any("are spikes" in words for words in learned.findings)
    assert learned.registration.trusted
    assert learned.registration.rotation_deg == pytest.approx(25, abs=3)


def test_readings_that_never_change_are_named():
    pressed = pressed_sheet(9)
    changes = pressed.changes.copy()
    changes[:, 7] = 40.0
    found = find_dead_readings(pressed.pairs, changes, pressed.labels_mm)
    assert np.flatnonzero(found.dead.all(axis=0)).tolist() == [7]
    assert ",".join(map(str, pressed.pairs[7])) in found.findings[0]
    changes[:, (pressed.pairs == 3).any(axis=1)] = 0.0
    found = find_dead_readings(pressed.pairs, changes, pressed.labels_mm)
    assert found.findings[0].startswith("electrode 3 is dead: its 48 readings never change")


def test_presses_that_nothing_is_known_of_accuse_no_electrode():
    pressed = pressed_sheet(60)
    noise = np.random.default_rng(1).standard_normal(pressed.changes.shape)
    assert not find_dead_readings(pressed.pairs, noise, pressed.labels_mm).dead.any()


def test_a_dead_electrode_costs_neither_pose_nor_place():
    pressed = pressed_sheet(140, noise=0.05)
    spoilt = without_contact(pressed, 5, common=False)
    learned = learn_presses(some(spoilt, np.arange(40)).labelled())
    assert learned.findings[0].startswith("electrode 5 is dead")
    assert learned.registration.trusted
    assert learned.registration.signal_share > 0.9
    later = spoilt.changes[40:].copy()
    later[0, (pressed.pairs == 5).any(axis=1)] = np.nan  # not even read
    places = PlaceEstimator(learned.place.model)(later)
    assert places.in_model.mean() > 0.9
    held = learned.place.held_out
    error = np.linalg.norm(places.place_mm - pressed.labels_mm[40:], axis=1)
    assert error.mean() < 3
    assert error.mean() == pytest.approx(held.mean_mm, abs=4 * held.stderr_mm)
