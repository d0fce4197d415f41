"""The expected error of force: its parts by hand, its bound over simulated maps, and what a press gains."""

import numpy as np
import pytest
from scipy.stats import chi2

from cbsr_qa.calibration.force.expected_error import (
    LoadErrors,
    LoadsThatMatter,
    _find_quantile,
    expect_after_presses,
    expect_force_error,
)
from cbsr_qa.calibration.sheet.response_map import learn_response
from cbsr_qa.calibration.sheet.response_processes import compute_covariance
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic

RADIUS_MM = 50.0
MATTER = LoadsThatMatter(40.0, (0.05, 0.3))
LEVER_N = 3.3
NOISE = 0.01


def sunflower(count):
    number = np.arange(count)
    radius, turn = 40 * np.sqrt((number + 0.5) / count), 2.4 * number
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])


def draw_map(seed, smooth, length_mm, count):
    """Presses of a sheet that varies by 20 %, and its true response at the places that matter."""
    generator = np.random.default_rng(seed)
    places, targets = sunflower(count), MATTER.places_mm()
    every = np.vstack([places, targets])
    covariance = 0.04 * compute_covariance(every, every, length_mm, smooth) + 1e-10 * np.eye(len(every))
    values = np.linalg.cholesky(covariance) @ generator.standard_normal(len(every))
    seen = values[:count] + NOISE * generator.standard_normal(count)
    return learn_response(places, seen, np.full(count, NOISE**2), radius_mm=RADIUS_MM), values[count:]


def test_the_lever_is_the_force_with_the_force_of_no_change():
    line = QuasiStatic(Parameter(0.005, None, ""), Parameter(0.01, None, ""), None)
    head = Indenter(13.0)
    strains = np.linspace(0.05, 0.3, 20_001)
    offset_N = 0.01 / 0.005 * head.area_mm2 * 1e-3
    expected = np.sqrt(np.mean((17.0 * strains + offset_N) ** 2))
    assert MATTER.lever_N(17.0, line, head) == pytest.approx(expected, rel=1e-4)


def test_every_radius_up_to_the_largest_matters_alike():
    radii = np.hypot(*MATTER.places_mm().T)
    assert np.allclose(np.sort(radii), 40 * (np.arange(64) + 0.5) / 64)


def test_the_quantile_of_one_member_is_that_of_its_chi_square():
    # A mean of five squared standard normals: mean 1, variance 2/5.
    quantile = _find_quantile(np.ones(1), np.ones(1), np.array([0.4]), 0.9)
    assert quantile == pytest.approx(chi2(5).ppf(0.9) / 5, rel=1e-9)


def test_parts_add_as_squares():
    response, _ = draw_map(1, True, 20.0, 12)
    alone = expect_force_error(response, MATTER.places_mm(), LoadErrors(LEVER_N, 0.0, 0.0), 0.8)
    full = expect_force_error(response, MATTER.places_mm(), LoadErrors(LEVER_N, 0.05, 0.02), 0.8)
    more = (0.02 * LEVER_N) ** 2 + 0.05**2
    assert full.expected_N**2 == pytest.approx(alone.expected_N**2 + more)
    assert alone.floor_N == pytest.approx(LEVER_N * response.scatter)
    assert full.floor_N < full.expected_N < full.upper_N


@pytest.mark.parametrize(("smooth", "length_mm"), [(True, 20.0), (False, 20.0), (True, 40.0)])
def test_the_error_of_simulated_maps_is_below_the_bound_as_often_as_is_stated(smooth, length_mm):
    errors = LoadErrors(LEVER_N, 0.0, 0.0)
    below, trials = 0, 40
    for seed in range(trials):
        response, true = draw_map(seed, smooth, length_mm, 12)
        bound = expect_force_error(response, MATTER.places_mm(), errors, 0.8)
        below += LEVER_N * np.sqrt(np.mean((response.predict(MATTER.places_mm())[0] - true) ** 2)) <= bound.upper_N
    assert below >= 0.8 * trials - 2 * np.sqrt(trials * 0.8 * 0.2)


def test_the_most_useful_press_is_where_nothing_was_pressed():
    response, _ = draw_map(3, True, 20.0, 12)
    errors, places = LoadErrors(LEVER_N, 0.0, 0.0), MATTER.places_mm()
    now = expect_force_error(response, places, errors, 0.8).expected_N
    pressed, between = sunflower(12)[4], sunflower(12)[[4, 6]].mean(axis=0)
    again_N, new_N = expect_after_presses(response, np.array([pressed, between]), places, errors, NOISE**2)
    assert new_N < again_N <= now
