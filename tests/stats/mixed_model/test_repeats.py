"""Repeated runs at one station, where sensors respond to stations differently."""

import numpy as np
import pytest
from fleet_designs import fleet

from cbsr_qa.stats.mixed_model.model import fit
from cbsr_qa.stats.mixed_model.repeats import average_repeats


def repeated(sensors=24, repeats=2):
    """Every sensor on three stations, so many runs at each."""
    return fleet([(n % 2, station, n) for n in range(sensors) for station in range(3) for _ in range(repeats)])


def draw_values(rows, seed, interaction):
    random = np.random.default_rng([830, seed])
    responses = interaction * random.normal(size=(rows.sensor.max() + 1, 3))
    values = rows.values(random, batches=[0, 0], stations=[0, 0, 0], run=0.3)
    return values + responses[rows.sensor, rows.station]


def test_runs_that_repeat_as_they_should_count_one_by_one():
    rows = repeated()
    assert average_repeats(rows.design, draw_values(rows, 1, 0.0)) is None


def test_means_are_those_of_a_sensor_at_a_station():
    rows = repeated()
    values = draw_values(rows, 2, 0.7)
    design, means = average_repeats(rows.design, values)
    expected = values.reshape(-1, 2).mean(axis=1)
    by_name = dict(zip(zip(rows.batch[::2], rows.station[::2], rows.sensor[::2], strict=True), expected, strict=True))
    found = dict(zip(zip(design.group, design.station, design.sensor, strict=True), means, strict=True))
    assert found == pytest.approx(by_name)


@pytest.mark.parametrize(
    "rows", [fleet([(n % 2, n % 3, n) for n in range(24) for _ in range(2)]), repeated(repeats=1)]
)
def test_a_sensor_at_one_station_or_once_at_each_leaves_nothing_to_average(rows):
    assert average_repeats(rows.design, np.random.default_rng(831).normal(size=len(rows.sensor))) is None


def test_intervals_of_stations_hold_where_sensors_respond_differently():
    """Within three standard errors of 200 fleets; run by run they hold in three quarters."""
    rows = repeated()
    held = {"one by one": [], "averaged": []}
    for seed in range(200):
        values = draw_values(rows, seed, 0.7)
        design, means = average_repeats(rows.design, values)
        for name, model in (("one by one", fit(rows.design, values)), ("averaged", fit(design, means))):
            interval = model.station_difference("s001", "s000").interval(0.95)
            held[name].append(interval.holds(0.0))
    assert np.mean(held["averaged"]) == pytest.approx(0.95, abs=0.046)
    assert np.mean(held["one by one"]) < 0.9
