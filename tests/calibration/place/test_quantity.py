"""Force and depth learned from presses of simulated sheets, held against the true ones of presses not seen."""

import numpy as np
import pytest
from pressed_sheets import pressed_sheet

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.place.drift import Session
from cbsr_qa.calibration.place.estimator import PlaceEstimator
from cbsr_qa.calibration.place.learning import learn_place
from cbsr_qa.calibration.place.places import Places
from cbsr_qa.calibration.place.quantity import (
    Quantities,
    QuantityEstimator,
    is_untold,
    learn_quantity,
    widen_intervals,
)

CENTRE = np.zeros(2)


def located(sheet, rows, *, seed=0, error_mm=0.5):
    """Presses found beside where they are, as strong as the root mean square of their readings."""
    shift = error_mm * np.random.default_rng([seed, 1]).standard_normal((len(sheet.force_N), 2))
    strength = np.sqrt((sheet.changes**2).mean(axis=1))
    return strength[rows], (sheet.places_mm + shift)[rows]


def told(learned, strength, places_mm):
    """What is told of presses that were located."""
    count, nothing = len(strength), np.zeros(len(strength))
    return QuantityEstimator(learned)(
        Places(places_mm, np.zeros((count, 2, 2)), nothing, strength, np.zeros(count, int))
    )


def inside(truth, within):
    return float(((within[:, 0] <= truth) & (truth <= within[:, 1])).mean())


@pytest.mark.rest
@pytest.mark.parametrize(("count", "limit_N"), [(39, 0.2), (150, 0.1)])
def test_intervals_hold_what_they_state_over_a_fleet(count, limit_N):
    shares, errors, stated = [], [], []
    for seed in range(8):
        sheet = pressed_sheet(count + 300, seed=seed, noise=0.1, uneven=0.2, rectified=seed % 2 == 1)
        some, rest = np.arange(count), np.arange(count, count + 300)
        learned = learn_quantity(sheet.force_N[some], *located(sheet, some, seed=seed), CENTRE)
        found, truth = told(learned, *located(sheet, rest, seed=seed)), sheet.force_N[rest]
        shares.append([inside(truth, found.within_68), inside(truth, found.within_95)])
        errors.append(np.abs(found.values - truth).mean())
        stated.append(learned.error)
    low, high = np.mean(shares, axis=0)
    assert 0.63 <= low <= 0.73
    assert 0.92 <= high <= 0.98
    assert np.mean(errors) < limit_N  # of 1 to 5 N; always guessing the middle errs by 1 N
    assert np.mean(stated) == pytest.approx(np.mean(errors), rel=0.3)


def test_a_quantity_that_readings_do_not_tell_is_the_middle_of_all_without_flags():
    """Depths that no reading knows: a fitted line would err more than guessing, and call some out of range."""
    sheet, random = pressed_sheet(300, seed=4, uneven=0.1), np.random.default_rng(4)
    depth_mm, some, rest = random.normal(19.0, 0.03, 300), np.arange(60), np.arange(60, 300)
    learned = learn_quantity(depth_mm[some], *located(sheet, some), CENTRE)
    found = told(learned, *located(sheet, rest))
    assert is_untold(learned)
    assert found.values == pytest.approx(np.median(depth_mm[some]), abs=1e-4)
    assert not (found.below | found.above).any()
    assert inside(depth_mm[rest], found.within_68) == pytest.approx(0.68, abs=0.15)
    assert inside(depth_mm[rest], found.within_95) == pytest.approx(0.95, abs=0.06)
    assert learned.error == pytest.approx(np.abs(depth_mm - np.median(depth_mm)).mean(), rel=0.25)


def test_forces_beyond_those_pressed_are_flagged_and_their_intervals_reach_back():
    sheet = pressed_sheet(200, seed=3, uneven=0.1)
    middle = np.flatnonzero((sheet.force_N > 2) & (sheet.force_N < 4))
    learned = learn_quantity(sheet.force_N[middle], *located(sheet, middle), CENTRE)
    beyond = np.flatnonzero((sheet.force_N < 1.8) | (sheet.force_N > 4.4))
    found, truth = told(learned, *located(sheet, beyond)), sheet.force_N[beyond]
    assert (found.below == (truth < 2)).mean() > 0.95
    assert (found.above == (truth > 4)).mean() > 0.95
    assert (found.within_68[found.above, 0] <= sheet.force_N[middle].max()).all()
    assert (found.within_68[found.below, 1] >= sheet.force_N[middle].min()).all()
    assert inside(truth, found.within_68) > 0.95


@pytest.mark.rest
def test_a_depth_may_be_counted_from_anywhere_and_upwards():
    """A robot's z in place of a depth: another origin and direction change nothing but the numbers."""
    sheet = pressed_sheet(200, seed=4, uneven=0.1)
    some, rest = np.arange(100), np.arange(100, 200)
    depth = -2 + 0.4 * np.log(sheet.force_N)
    there, here = (
        told(learn_quantity(values[some], *located(sheet, some), CENTRE), *located(sheet, rest))
        for values in (7 - depth, depth)
    )
    assert np.abs(here.values - depth[rest]).mean() < 0.03
    assert 7 - there.values == pytest.approx(here.values, abs=0.01)
    assert 0.55 < inside(depth[rest], here.within_68) < 0.8


@pytest.fixture(scope="module")
def learned():
    """A sheet, and the places and forces learned from its first 60 presses."""
    sheet = pressed_sheet(160, seed=7, noise=0.05, uneven=0.2)
    place = learn_place(sheet.changes[:60], sheet.labels_mm[:60], sheet.pairs, 16)
    known = place.found
    quantity = learn_quantity(sheet.force_N[known.presses], known.strength, known.place_mm, place.model.centre_mm)
    return sheet, place.model, quantity


def test_strengths_of_a_learned_place_tell_the_force(learned):
    sheet, place, quantity = learned
    found = QuantityEstimator(quantity)(PlaceEstimator(place)(sheet.changes[60:]))
    error = np.abs(found.values - sheet.force_N[60:])
    assert error.mean() < 0.15
    assert error.mean() == pytest.approx(quantity.error, rel=0.5)
    assert inside(sheet.force_N[60:], found.within_95) > 0.85


@pytest.mark.parametrize("nothing", [0.0, 1e-300, np.nan])
def test_frames_without_a_press_have_no_force_and_change_no_other(learned, nothing):
    sheet, place, quantity = learned
    changes = sheet.changes[60:100].copy()
    untouched = np.arange(len(changes)) % 3 == 0
    pressed = QuantityEstimator(quantity)(PlaceEstimator(place)(changes))
    changes[untouched] = nothing
    places = PlaceEstimator(place)(changes)
    found = QuantityEstimator(quantity)(places)
    assert ((places.flags[untouched] & (Flag.NOT_DETECTED | Flag.UNREADABLE)) != 0).all()
    assert np.isnan(found.values[untouched]).all()
    assert np.isnan(found.within_95[untouched]).all()
    assert not (found.below | found.above)[untouched].any()
    np.testing.assert_allclose(found.values[~untouched], pressed.values[~untouched], rtol=1e-9)
    np.testing.assert_allclose(found.within_68[~untouched], pressed.within_68[~untouched], rtol=1e-9)


def test_a_gain_that_drifts_is_followed_and_intervals_hold_later_forces():
    """Readings grow by a half over 120 presses; those told follow within a session, and grow on."""
    sheet = pressed_sheet(240, seed=5, noise=0.1, uneven=0.1)
    gain = np.exp(0.4 * np.arange(240) / 120)
    strength, places_mm = located(sheet, np.arange(240))
    some, rest = np.arange(120), np.arange(120, 240)
    learned, still = (
        learn_quantity(sheet.force_N[some], (gain * strength)[some], places_mm[some], CENTRE, session=session)
        for session in (Session(np.linspace(0, 1, 120), 0), None)
    )
    truth = sheet.force_N[rest]
    found, before = (told(each, (gain * strength)[rest], places_mm[rest]) for each in (learned, still))
    assert np.abs(found.values - truth).mean() < 0.7 * np.abs(before.values - truth).mean()
    assert inside(truth, found.within_95) > 0.93
    assert learned.error < 0.7 * still.error
    now = told(learned, (gain[119] * strength)[rest], places_mm[rest])
    assert np.abs(now.values - truth).mean() < 0.15


@pytest.mark.rest
def test_presses_in_random_order_show_no_drift():
    sheet = pressed_sheet(100, seed=6, noise=0.1)
    learned, still = (
        learn_quantity(sheet.force_N, *located(sheet, np.arange(100)), CENTRE, session=session)
        for session in (Session(np.linspace(0, 1, 100), 0), None)
    )
    assert (learned.drift, learned.weak_drift) == (0.0, 0.0)
    np.testing.assert_array_equal(learned.quantiles, still.quantiles)


def test_presses_at_one_place_are_left_out_together():
    """Their strengths err alike, so they tell of one another what they do not tell of new places."""
    sheet = pressed_sheet(40, seed=8, noise=0.02, uneven=0.3)
    strength, places_mm = located(sheet, np.arange(40), error_mm=0.0)
    visits, force_N = np.repeat(np.arange(40), 4), np.random.default_rng(1).uniform(1.0, 5.0, 160)
    there = strength[visits] * force_N / sheet.force_N[visits], places_mm[visits]
    together, alone = (learn_quantity(force_N, *there, CENTRE, visits=each) for each in (visits, None))
    assert together.error > 2 * alone.error
    assert together.error_stderr > alone.error_stderr


def test_widened_intervals_hold_a_shared_error_too():
    """20 000 values with scatter of 0.1 and a factor known to 3 %, each of another calibration."""
    random = np.random.default_rng(12)
    true = random.uniform(1, 5, 20_000)
    values = true * (1 + 0.03 * random.standard_normal(len(true))) + 0.1 * random.standard_normal(len(true))
    inner, outer = (values[:, None] + times * 0.1 * np.array([-1.0, 1.0]) for times in (0.9945, 1.96))
    nowhere = np.zeros(len(true), dtype=bool)
    widened = widen_intervals(Quantities(values, inner, outer, nowhere, nowhere), 0.03 * values)
    for within, share in ((widened.within_68, 0.68), (widened.within_95, 0.95)):
        held = np.mean((within[:, 0] <= true) & (true <= within[:, 1]))
        assert held == pytest.approx(share, abs=0.01)
    at_zero = Quantities(np.array([0.1]), np.array([[0.05, 0.2]]), np.array([[0.0, 0.4]]), nowhere[:1], nowhere[:1])
    assert widen_intervals(at_zero, np.array([1.0])).within_68[0, 0] == 0
