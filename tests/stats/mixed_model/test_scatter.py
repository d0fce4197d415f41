"""Groups that scatter differently: Welch's test as the exact case, dense weights, and truth by simulation."""

import numpy as np
import pytest
from fleet_designs import fleet, uneven

from cbsr_qa.stats.difference import welch
from cbsr_qa.stats.mixed_model.model import Model, fit
from cbsr_qa.stats.mixed_model.scatter import LEVEL, fit_scatter, scatter_p_value

DEVIATIONS = np.array([0.5, 1.0, 3.0])


def one_station(sensors=20, groups=3):
    return fleet([(number // sensors, 0, number) for number in range(groups * sensors)])


def draw_sensors(rows, seed, deviations):
    random = np.random.default_rng([820, seed])
    return deviations[rows.batch] * random.normal(size=rows.sensor.max() + 1)[rows.sensor]


def test_two_groups_at_one_station_are_compared_as_welch_does():
    """Groups of equal size at one station: difference, error and degrees of freedom are Welch's."""
    rows = one_station(groups=2)
    values = draw_sensors(rows, 1, np.array([0.3, 3.0]))
    found = fit_scatter(fit(rows.design, values), values).group_difference("b001", "b000")
    expected = welch(values[20:], values[:20])
    assert found.value == pytest.approx(expected.value, rel=1e-10)
    assert found.standard_error == pytest.approx(expected.standard_error, rel=1e-9)
    assert found.freedom == pytest.approx(expected.freedom, rel=1e-9)


def test_groups_that_scatter_alike_stay_as_they_are():
    rows = one_station()
    values = draw_sensors(rows, 2, np.ones(3))
    alike = fit(rows.design, values)
    assert fit_scatter(alike, values) is alike


def test_effects_are_those_of_dense_weighted_least_squares():
    rows = uneven(np.random.default_rng(821), sensors=60)
    random = np.random.default_rng(822)
    sensors = draw_sensors(rows, 3, DEVIATIONS)
    values = sensors + 0.3 * random.normal(size=len(rows.sensor))
    found = fit_scatter(fit(rows.design, values), values)
    assert found.model is Model.MIXED
    same_sensor = rows.sensor[:, None] == rows.sensor[None, :]
    run, between = found.scatter.run_deviation**2, found.scatter.sensor_deviations**2
    inverse = np.linalg.inv(run * np.eye(len(values)) + between[rows.batch][:, None] * same_sensor)
    matrix = rows.design.columns().toarray()
    covariance = np.linalg.inv(matrix.T @ inverse @ matrix)
    effects = covariance @ matrix.T @ inverse @ values
    assert found.effects[rows.design.independent_columns()] == pytest.approx(effects, rel=1e-7, abs=1e-7)
    assert found.covariance == pytest.approx(covariance, rel=1e-9)
    assert np.sqrt(run) == pytest.approx(0.3, rel=0.2)
    drawn = [np.std(np.unique(sensors[rows.batch == batch]), ddof=1) for batch in range(3)]
    assert np.sqrt(between) == pytest.approx(drawn, rel=0.25)


def test_the_test_keeps_its_level_and_finds_what_differs():
    """Skewed sensors (exponential) raise no alarm; three standard errors of 300 fleets."""
    rows = one_station()
    random = np.random.default_rng(823)
    for draw in (random.normal, random.exponential):
        alarms = []
        for _ in range(300):
            values = draw(size=60)
            alarms.append(scatter_p_value(fit(rows.design, values), values) < LEVEL)
        assert np.mean(alarms) <= LEVEL + 3 * np.sqrt(LEVEL / 300)
    found = [draw_sensors(rows, seed, DEVIATIONS) for seed in range(40)]
    assert all(scatter_p_value(fit(rows.design, values), values) < LEVEL for values in found)


def test_a_group_of_sensors_that_read_the_same_does_not_weigh_without_bound():
    rows = one_station()
    values = draw_sensors(rows, 4, np.array([0.0, 1.0, 1.0]))
    found = fit_scatter(fit(rows.design, values), values).group_difference("b002", "b001")
    expected = welch(values[40:], values[20:40])
    assert found.value == pytest.approx(expected.value, rel=1e-9)
    assert found.standard_error == pytest.approx(expected.standard_error, rel=1e-6)


def test_deviations_whose_squares_are_below_the_smallest_numbers_end_no_comparison():
    rows = one_station()
    values = 1e-160 * draw_sensors(rows, 5, DEVIATIONS)
    scatter = fit_scatter(fit(rows.design, values), values).scatter
    assert scatter.sensor_deviations[2] / scatter.sensor_deviations[0] == pytest.approx(6, rel=0.5)
    assert scatter.scale(1e160).sensor_deviations == pytest.approx(1e160 * scatter.sensor_deviations)
