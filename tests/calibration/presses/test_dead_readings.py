"""Readings that tell nothing of the press are found, named and left out; those of a sound sheet are not."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_sheets import adjacent_pairs, opposite_pairs, pressed_sheet, some

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.place.estimator import PlaceEstimator
from cbsr_qa.calibration.place.mixture import mahalanobis
from cbsr_qa.calibration.place.quantity import QuantityEstimator
from cbsr_qa.calibration.presses.dead_readings import estimate_clipped_share, find_dead_readings
from cbsr_qa.calibration.presses.learning import learn_presses
from cbsr_qa.calibration.presses.odd_units import find_odd_readings, find_odd_rows


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


def with_spikes(pressed):
    """One reading of twenty a hundred times as high, and which they are (n, m)."""
    random = np.random.default_rng(8)
    spikes = random.random(pressed.changes.shape) < 0.05
    height = 100 * np.median(np.abs(pressed.changes)) * random.choice([-1.0, 1.0], spikes.shape)
    return replace(pressed, changes=np.where(spikes, height, pressed.changes)), spikes


def test_spikes_are_found_and_no_others():
    spiky, spikes = with_spikes(pressed_sheet(140, noise=0.05))
    found = find_dead_readings(spiky.pairs, spiky.changes, spiky.labels_mm)
    assert found.dead[spikes].mean() > 0.98
    assert found.dead[~spikes].mean() < 0.005


@pytest.mark.rest
def test_spikes_do_not_make_a_sheet_a_foreign_one():
    spiky, _ = with_spikes(pressed_sheet(140, noise=0.05))
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


@pytest.mark.rest
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


def test_an_electrode_that_is_open_in_every_press_is_found_against_the_unloaded_sheet():
    pressed, random = pressed_sheet(60, noise=0.05), np.random.default_rng(4)
    of, noise = (pressed.pairs == 5).any(axis=1), 0.05 * np.median(np.abs(pressed.changes))
    frames = pressed.changes + pressed.unloaded
    frames[:, of] = noise * random.standard_normal((60, of.sum()))
    rest, deviation = pressed.unloaded, np.full(len(pressed.pairs), noise)
    found = find_dead_readings(pressed.pairs, frames - rest, pressed.labels_mm, rest, deviation)
    np.testing.assert_array_equal(found.dead.all(axis=0), of)
    (words,) = found.findings
    assert words.startswith("electrode 5 is dead: its 48 readings")


@pytest.mark.parametrize("whole", [False, True])
def test_clipped_readings_are_told_from_others(whole):
    pressed, rectified = pressed_sheet(60, noise=0.05), pressed_sheet(60, rectified=True)
    rest = pressed.unloaded if whole else np.zeros(len(pressed.pairs))
    frames = pressed.changes + rest
    least, most = np.quantile(frames, [0.0, 0.95])
    cut = np.clip(frames, least, most) - np.clip(rest, least, most)
    given = np.clip(rest, least, most) if whole else None
    assert estimate_clipped_share(cut, given) == pytest.approx(0.05, abs=0.005)
    coarse = np.round(frames / np.median(np.abs(pressed.changes)))
    for sound in (frames, coarse, np.sign(frames), rectified.changes + rectified.unloaded):
        assert estimate_clipped_share(sound - rest, rest if whole else None) == 0


@pytest.mark.rest
def test_clipped_readings_are_blamed_not_the_radius():
    pressed = pressed_sheet(12, seed=1, noise=0.05)
    most = np.quantile(np.abs(pressed.changes), 0.6)
    found = learn_presses(replace(pressed, changes=np.clip(pressed.changes, -most, most)).labelled()).findings
    assert "of the readings are clipped" in found[0]
    assert "clipped readings make places seem nearer" in found[1]
    assert not any("radius" in words for words in found)


def test_places_in_metres_are_named():
    pressed = pressed_sheet(12, scale=1e-3, shift_mm=(0.046, -0.408))
    learned = learn_presses(replace(pressed.labelled(), radius_stated=False))
    assert "seem to be in metres" in learned.findings[0]
    assert not learned.registration.trusted


def spoilt_presses(pressed, rows, random):
    """Open an electrode, another in each of these presses: its readings are none."""
    changes = pressed.changes.copy()
    for row in rows:
        of = (pressed.pairs == random.integers(16)).any(axis=1)
        changes[row, of] = -pressed.unloaded[of]
    return replace(pressed, changes=changes)


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.rest)])
def test_open_electrodes_in_some_presses_and_frames_are_named_and_cost_little(whole):
    pressed, random = pressed_sheet(100, seed=50, noise=0.05), np.random.default_rng(3)
    spoilt = spoilt_presses(pressed, [7, 21, 33], random)
    spoilt.changes[12] += 30 * np.median(np.abs(pressed.changes))  # an offset: nothing is left of that press
    labelled = some(spoilt, np.arange(60)).labelled()
    if whole:
        labelled = replace(labelled, readings=replace(labelled.readings, rest=pressed.unloaded))
    else:
        labelled = replace(labelled, presses=replace(labelled.presses, force_N=pressed.force_N[:60]))
    learned = learn_presses(labelled)
    assert [row for row, why in enumerate(learned.why_not) if why] == [12]
    assert "offset" in learned.why_not[12]
    assert any("presses with faulty readings" in words and "row 8" in words for words in learned.findings)
    locate = PlaceEstimator(learned.place.model, pairs=pressed.pairs)
    truth, sound = pressed.labels_mm[60:], locate(pressed.changes[60:])
    assert np.linalg.norm(sound.place_mm - truth, axis=1).mean() < 0.4  # 0.2 mm without these presses
    faulty = locate(spoilt_presses(pressed, range(60, 100), random).changes[60:])
    assert (faulty.flags & (Flag.OPEN_ELECTRODE | Flag.DEAD_PAIR) > 0).all()
    error = truth - faulty.place_mm
    assert np.linalg.norm(error, axis=1).mean() < 1.5
    ratio = mahalanobis(error[faulty.in_model], faulty.covariance_mm2[faulty.in_model])
    assert (ratio <= locate.q95).mean() > 0.9
    for quantity in learned.quantities.values():
        told, force = QuantityEstimator(quantity)(faulty), pressed.force_N[60:, None]
        inside = [((each - force) * [-1, 1] >= 0).all(axis=1).mean() for each in (told.within_68, told.within_95)]
        assert inside[0] > 0.6
        assert inside[1] > 0.85  # 0.54 and 0.63 with the intervals of whole frames
    assert not locate(spoilt.changes[12:13]).in_model.any()


def test_a_row_in_another_unit_is_left_out_for_that_reason():
    pressed = pressed_sheet(60, noise=0.05)
    for factor in (1000.0, 1e-3):
        changes = pressed.changes.copy()
        changes[7] *= factor
        found = find_dead_readings(pressed.pairs, changes, pressed.labels_mm)
        assert [row for row, why in enumerate(found.left_out) if why] == [7]
        assert "times as large as those of the others, as if in another unit" in found.left_out[7]


def test_a_single_reading_in_another_unit_is_named_by_row_and_column():
    pressed = pressed_sheet(60, noise=0.05)
    columns = tuple(f"r{column}" for column in range(len(pressed.pairs)))
    changes = pressed.changes.copy()
    changes[7, 40] *= 1000
    found = find_dead_readings(pressed.pairs, changes, pressed.labels_mm, columns=columns)
    (words,) = found.findings
    assert words.startswith("row 8, column r40: about ")
    assert words.endswith("as if in another unit; it is left out, the others of the press are used")
    assert not any(found.left_out)
    assert found.dead[7, 40]
    (by_pair,) = find_dead_readings(pressed.pairs, changes, pressed.labels_mm).findings
    assert f"pair {','.join(map(str, pressed.pairs[40]))}" in by_pair


def test_no_press_of_a_real_skin_is_in_another_unit(shared):
    for name in ("no_pattern", "parallel_lines"):
        changes = np.loadtxt(shared / "data" / "skins" / name / "readings.csv", delimiter=",", encoding="utf-8-sig")
        assert not list(find_odd_rows(changes))
        assert not list(find_odd_readings(changes))
