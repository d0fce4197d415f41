"""What hard cases are held against: condition numbers are what perturbations do; truth does not follow answers."""

from dataclasses import replace

import numpy as np
import pytest

from cbsr_qa.calibration.fits.settling import settling_time
from cbsr_qa.calibration.sheet.response_map import learn_response
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.stats.golden_lots import lot_limits
from cbsr_qa.stats.intervals import count_needed
from cbsr_qa.studies.hard_cases.cases import relaxation as relaxation_cases, statistics as statistics_cases
from cbsr_qa.studies.hard_cases.exact import exact_line, line_condition, map_condition

X = np.array([0.05, 0.10, 0.15, 0.20, 0.25, 0.30])
Y = 0.6 * X + 0.01 * np.cos(40 * X)


@pytest.mark.parametrize("stderr", [np.ones(6), np.array([1, 2, 0.1, 1, 3, 1])], ids=["alike", "weighted"])
@pytest.mark.parametrize("offset", [0.0, 1e3])
def test_condition_of_a_line_is_what_relative_changes_of_its_loads_do(stderr, offset):
    x, step, moved = X + offset, 1e-9, 0.0
    slope, _ = exact_line(x, Y, stderr)
    for k in range(6):
        bent = np.where(np.arange(6) == k, 1 + step, 1.0)
        moved += abs(exact_line(x * bent, Y, stderr)[0] - slope) + abs(exact_line(x, Y * bent, stderr)[0] - slope)
    assert line_condition(x, Y, stderr) == pytest.approx(float(moved / abs(slope) / step), rel=1e-3)


def test_a_load_known_far_better_than_the_others_does_not_make_a_line_ill_conditioned():
    certain = line_condition(X, Y, np.array([1, 1, 1e-12, 1, 1, 1]))
    assert certain < 10
    assert line_condition(1e6 + X, Y, np.ones(6)) > 1e5


@pytest.mark.rest
def test_loads_far_apart_do_not_make_a_map_ill_conditioned_however_well_one_is_known():
    places = np.array(NINE_LOCATIONS_MM)
    variance = np.full(9, 1e-2)
    variance[0] = 1e-14
    learned = learn_response(places, 0.1 * np.sin(places[:, 0] / 20), variance, radius_mm=50.0)
    assert map_condition(learned, places, variance) < 1e6


def _first_crossing(fit, *, window_s):
    """The settling time of one who stops at the first time the curve is within its band."""
    times = np.linspace(0, window_s, 60_001)
    left = np.abs(np.exp(-times[:, None] / np.array(fit.time_constants_s)) @ np.array(fit.amplitudes))
    return replace(settling_time(fit, window_s=window_s), value_s=float(times[(left < 0.15).argmax()]))


def test_a_settling_time_at_another_crossing_of_the_band_is_found_out(monkeypatch):
    amplitudes, taus_s = (1.0, -0.6), (5.0, 20.0)  # into the band, out at its other side, and in again
    right = relaxation_cases.settle_known_curve(amplitudes, taus_s)
    assert right.error <= right.bound
    monkeypatch.setattr(relaxation_cases, "settling_time", _first_crossing)
    wrong = relaxation_cases.settle_known_curve(amplitudes, taus_s)
    assert wrong.error > 0.5


def test_a_lot_limit_rounded_inwards_is_found_out(monkeypatch):
    values = [1e9 + 0.01 * k for k in range(8)]
    right = statistics_cases.limits_of(values)
    assert right.error <= right.bound

    def inwards(*given):
        found = lot_limits(*given)
        return replace(found, upper=replace(found.upper, limit=found.upper.limit - 1e-3))

    monkeypatch.setattr(statistics_cases, "lot_limits", inwards)
    wrong = statistics_cases.limits_of(values)
    assert wrong.error > wrong.bound


@pytest.mark.parametrize("off", [-1, 1])
def test_one_sensor_more_or_fewer_of_billions_is_found_out(monkeypatch, off):
    right = statistics_cases.sensors_for_rare_failures()
    assert right.error <= right.bound
    monkeypatch.setattr(statistics_cases, "count_needed", lambda *given: count_needed(*given) + off)
    wrong = statistics_cases.sensors_for_rare_failures()
    assert wrong.error > wrong.bound
