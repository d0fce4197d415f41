"""Expanded uncertainties hold a truth that is drawn from what is stated, on fewer sensors than the benchmark has."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.expanded_uncertainty import SETTINGS, make_calibration, simulate_sensor
from benchmarks.uncertainty_rates import compare_conformance, hold_rates, mean_shares, normalised_variance
from cbsr_qa.calibration.uncertainty.budget import evaluate_forces

SENSORS, LOADS = 60, 12


@pytest.fixture(scope="module")
def told():
    issued = make_calibration(SETTINGS["usual"])
    return [simulate_sensor(issued, seed, LOADS) for seed in range(SENSORS)]


@pytest.mark.rest
def test_u_holds_forces_and_places_of_95_percent(told):
    for rate, stderr in hold_rates(told).values():
        assert abs(rate - 0.95) < 3 * stderr + 0.01
        assert stderr < 0.03
    mean, _ = normalised_variance(told)
    assert mean == pytest.approx(1, abs=0.15)


@pytest.mark.rest
def test_stated_probabilities_of_conformance_are_the_shares_that_conform():
    """Nothing is supposed of a sensor's errors beforehand: where they are many times u, the shares agree."""
    issued = make_calibration(SETTINGS["a map of few places"])
    told = [simulate_sensor(issued, seed, 30) for seed in range(2 * SENSORS)]
    bins = compare_conformance(told)
    assert len(bins) == 7
    for stated, share, stderr, count in bins:
        assert count >= 30
        assert abs(share - stated) < 3 * stderr + 0.06


@pytest.mark.rest
def test_loads_conform_at_least_as_often_as_stated_where_errors_are_small(told):
    """The errors of usual sensors are near zero, which the probability does not suppose."""
    for stated, share, stderr, _ in compare_conformance(told):
        assert share > stated - 3 * stderr


@pytest.mark.rest
def test_a_component_of_a_tenth_of_the_variance_shows_when_it_is_left_out(told):
    shares = mean_shares(told)
    large = [name for name, share in shares.items() if share >= 0.1]
    assert len(large) >= 3
    for name in large:
        mean, p_value = normalised_variance(told, name)
        assert (mean > 1, p_value < 0.01) == (True, True), name


@pytest.mark.parametrize("role", ["stage", "thermometer", "source_meter"])
def test_a_standard_that_is_not_stated_changes_u_by_its_share(role):
    issued = make_calibration(SETTINGS["usual"])
    without = replace(issued, standards=tuple(one for one in issued.standards if one.role != role))
    (full,), (less,) = (evaluate_forces(one, [4.0], [(20.0, 10.0)]) for one in (issued, without))
    kept = {part.name: part.contribution for part in less.components}
    lost = (
        sum(part.contribution**2 - kept.get(part.name, 0.0) ** 2 for part in full.components)
        / full.standard_uncertainty_N**2
    )
    assert 0 < lost < 0.2  # of two axes, for a stage
    assert pytest.approx(np.sqrt(1 - lost), rel=3e-3) == less.U_N / full.U_N
    within = {f"drift of the {role}", f"resolution of the {role}"}
    assert set(full.not_stated) - within < set(less.not_stated)
