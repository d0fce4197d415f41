"""Budgets of the error that a checked load shows, and of a force on the day of calibration and in use."""

from dataclasses import replace
from math import hypot

import numpy as np
import pytest
from scipy.stats import t as student_t

from benchmarks.expanded_uncertainty import SETTINGS, make_calibration
from cbsr_qa.calibration.sheet.response_map import learn_response
from cbsr_qa.calibration.sheet.response_processes import compute_covariance
from cbsr_qa.calibration.uncertainty.budget import ReferencePress, evaluate_errors, evaluate_forces
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.results.calibration import BaselineConductance
from cbsr_qa.domain.results.expanded_force import GAIN_DRIFT, Result

PLACE = (12.5, -7.0)
PRESS = ReferencePress(PLACE, 55.0, 3.0, 0.01, 8, 3.0)


@pytest.fixture(scope="module")
def issued():
    return make_calibration(SETTINGS["usual"])


def parts(expanded):
    return {part.name: part.standard_uncertainty for part in expanded.components}


def test_an_error_has_the_inputs_of_its_press_and_of_the_reference_alone(issued):
    (error,), (force,) = evaluate_errors(issued, [PRESS]), evaluate_forces(issued, [3.0], [PLACE])
    of_sensor = {"response of the sheet", "characteristic of the material"}
    of_use = {"temperature", GAIN_DRIFT}
    assert set(parts(force)) - set(parts(error)) == of_sensor | of_use
    assert set(parts(error)) - set(parts(force)) == {"scatter of the load cell"}
    for name in set(parts(error)) & set(parts(force)):
        assert parts(error)[name] == parts(force)[name], name
    assert parts(error)["load cell"] > 0  # it made the calibration too: the difference does not show it
    assert parts(error)["scatter of the load cell"] == 0.01
    assert {part.name: part.dof for part in error.components}["scatter of the load cell"] == 7
    assert error.U_N < force.U_N


def test_in_use_a_force_has_the_drift_of_gains_and_temperatures_beyond_the_day_of_calibration(issued):
    day, use = (
        evaluate_forces(issued, [3.0], [PLACE], result=when)[0] for when in (Result.ON_THE_DAY, Result.IN_USE)
    )
    added_N = hypot(parts(use)["temperature"], parts(use)[GAIN_DRIFT])
    assert hypot(day.standard_uncertainty_N, added_N) == pytest.approx(use.standard_uncertainty_N)
    assert set(use.not_stated) - set(day.not_stated) == {
        "ageing of the sensor",
        "drift of the thermometer",
        "resolution of the thermometer",
    }


def test_a_single_sample_tells_no_scatter_of_the_load_cell(issued):
    (error,) = evaluate_errors(issued, [replace(PRESS, samples=1, stderr_N=0.0)])
    assert "scatter of the load cell" in error.not_stated


@pytest.mark.parametrize(("settling_s", "is_stated"), [(55.0, True), (50.0, True), (20.0, False), (200.0, False)])
def test_a_hold_unlike_the_calibrated_one_needs_a_kernel(issued, settling_s, is_stated):
    (error,) = evaluate_errors(issued, [replace(PRESS, settling_s=settling_s)])
    assert ("prediction of transients" in error.not_stated) is not is_stated
    assert error.settling_s == settling_s


def test_an_error_outside_the_range_has_no_uncertainty(issued):
    with pytest.raises(CalibrationError, match="a force of 9 N is outside the calibrated range"):
        evaluate_errors(issued, [replace(PRESS, force_N=9.0, steady_N=9.0)])


def test_a_press_lies_in_the_range_by_the_force_that_the_range_is_set_by(issued):
    _, highest_N = issued.validity.force_N
    press = replace(PRESS, force_N=highest_N + 0.004, steady_N=highest_N)
    (error,) = evaluate_errors(issued, [press])
    assert error.force_N == press.force_N
    with pytest.raises(CalibrationError, match="is outside the calibrated range"):
        evaluate_errors(issued, [replace(press, force_N=highest_N, steady_N=highest_N + 0.004)])


@pytest.mark.rest
@pytest.mark.parametrize("places", [9, 16])
def test_u_of_an_error_holds_the_scatter_of_loads_pressed_once(issued, places):
    """The scatter is learned with the map; its degrees of freedom make up for how little it is known."""
    once = tuple(BaselineConductance(f"L{n}", 3.0 * n, 0.0, 0.3, 0.01, 1) for n in range(places))
    (wide,) = evaluate_errors(replace(issued, baseline=once), [PRESS])
    (plain,) = evaluate_errors(issued, [PRESS])
    reach = parts(wide)["repeatability"] / parts(plain)["repeatability"] * student_t.ppf(0.975, 5)
    rates = {}
    for scatter in (0.01, 0.02, 0.04):
        held = [_hold_scatter(places, scatter, reach, seed) for seed in range(80)]
        rates[scatter] = float(np.mean(held)), float(np.std(held) / np.sqrt(len(held)))
    for scatter, (rate, stderr) in rates.items():
        assert rate > 0.93 - 3 * stderr, (places, scatter)
    assert np.mean([rate for rate, _ in rates.values()]) > 0.94


def _hold_scatter(places, scatter, reach, seed):
    """Learn a map from places pressed once, and return the share of further loads within the reach of its scatter."""
    random = np.random.default_rng([101, places, seed])
    angle, radius_mm = random.uniform(0, 2 * np.pi, places), 35 * np.sqrt(random.uniform(0, 1, places))
    place_mm = np.column_stack([radius_mm * np.cos(angle), radius_mm * np.sin(angle)])
    covariance = 0.06**2 * compute_covariance(place_mm, place_mm, 20.0, True) + 1e-10 * np.eye(places)
    response = np.linalg.cholesky(covariance) @ random.standard_normal(places)
    pressed = response + np.hypot(scatter, 0.003) * random.standard_normal(places)
    learned = learn_response(place_mm, pressed, np.full(places, 0.003**2), radius_mm=50.0)
    return float(np.mean(np.abs(scatter * random.standard_normal(400)) <= reach * learned.scatter))
