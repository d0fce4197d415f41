"""Sessions as random effect: dense generalised least squares, balanced closed forms, and truth by simulation."""

from dataclasses import replace

import numpy as np
import pytest
from fleet_designs import fleet, uneven
from scipy import sparse, stats

from cbsr_qa.stats.mixed_model.model import Model, fit
from cbsr_qa.stats.mixed_model.reml import random_effect_sums, variance_ratio
from cbsr_qa.stats.mixed_model.sessions import (
    Departure,
    SessionRatio,
    add_sessions,
    correlate,
    fit_session_means,
    lack_of_fit,
)


def balanced(sensors=4, groups=3, stations=3):
    """Every sensor once; so many of each group at each station."""
    cells = [(group, station) for group in range(groups) for station in range(stations) for _ in range(sensors)]
    return fleet([(group, station, number) for number, (group, station) in enumerate(cells)])


def draw_metrics(rows, seed, count, *, session=0.0, sensor=1.0):
    """Values of several metrics (count, N) without differences, with a deviation of sessions."""
    random = np.random.default_rng([810, seed])
    keys = np.unique(rows.batch * 10 + rows.station, return_inverse=True)[1]
    sessions = random.normal(0, session, (count, keys.max() + 1))[:, keys]
    sensors = random.normal(0, sensor, (count, rows.sensor.max() + 1))[:, rows.sensor]
    return sessions + sensors + random.normal(0, 0.3, (count, len(keys)))


def find_lack(rows, metrics):
    models = [fit(rows.design, values) for values in metrics]
    means = [fit_session_means(model, values) for model, values in zip(models, metrics, strict=True)]
    return models, means, lack_of_fit([one.departure() for one in means], correlate(means))


def test_the_departure_is_the_f_of_the_interaction():
    """Balanced, one run a sensor: the analysis of variance of two factors."""
    rows = balanced()
    (values,) = draw_metrics(rows, 1, 1)
    cells = values.reshape(3, 3, 4)
    means = cells.mean(axis=2)
    interaction = means - means.mean(axis=0) - means.mean(axis=1, keepdims=True) + means.mean()
    error = np.sum((cells - means[..., None]) ** 2) / 27
    found = fit_session_means(fit(rows.design, values), values).departure()
    assert (found.freedom, found.run_freedom) == (4, 27)
    assert found.statistic == pytest.approx(4 * np.sum(interaction**2) / 4 / error, rel=1e-12)
    assert found.gain == pytest.approx(4)  # sensors of a session


@pytest.mark.parametrize("ratio", [1.0, 1.7, 30.0])
def test_effects_and_covariance_are_those_of_dense_generalised_least_squares(ratio):
    """With the sensors' ratio that the runs within sessions give, and no adjustment for small samples."""
    rows = uneven(np.random.default_rng(811))
    values = rows.values(np.random.default_rng(812), batches=[0, 1, 2], stations=[0, 3, 1], run=0.6)
    model = fit(rows.design, values)
    assert model.model is Model.MIXED
    members = np.eye(9)[3 * rows.batch + rows.station]
    members = members[:, members.any(axis=0)]
    theta = variance_ratio(random_effect_sums(sparse.csr_array(members), values, rows.sensor)).value
    h = np.eye(len(values)) + theta * (rows.sensor[:, None] == rows.sensor[None, :])
    plain = np.linalg.inv(members.T @ np.linalg.inv(h) @ members)
    means = replace(fit_session_means(model, values), covariance=plain)
    found = add_sessions(model, means, SessionRatio(ratio, 5.0))

    rho = (ratio - 1) / means.departure().gain
    inverse = np.linalg.inv(h + rho * members @ members.T)
    matrix = rows.design.columns().toarray()
    covariance = np.linalg.inv(matrix.T @ inverse @ matrix)
    effects = covariance @ matrix.T @ inverse @ values
    assert found.effects[rows.design.independent_columns()] == pytest.approx(effects, rel=1e-7, abs=1e-7)
    assert found.covariance == pytest.approx(means.variance * covariance, rel=1e-7)
    assert found.session_deviation == pytest.approx(np.sqrt(rho * means.variance))


def test_balanced_sessions_are_judged_by_the_interaction():
    """With the ratio F itself, the error of a difference of batches is that of the mean square of the interaction."""
    rows = balanced()
    (values,) = draw_metrics(rows, 2, 1, session=1.0)
    model = fit(rows.design, values)
    means = fit_session_means(model, values)
    departure = means.departure()
    contrast = add_sessions(model, means, SessionRatio(departure.statistic, 4.0)).group_difference("b001", "b000")
    assert contrast.standard_error**2 == pytest.approx(departure.statistic * means.variance * 2 / 12, rel=1e-9)
    # Of the ratio's 4 and the error's 27; the mean square itself would have 4.
    assert contrast.freedom == pytest.approx(1 / (1 / 27 + 1 / 4), rel=1e-9)


def test_no_departure_can_be_seen_in_a_chain_of_batches_and_stations():
    rows = fleet([(number // 4, (number % 4 > 1) + number // 4, number) for number in range(12)])
    (values,) = draw_metrics(rows, 3, 1)
    assert fit_session_means(fit(rows.design, values), values) is None


def test_metrics_count_as_the_independent_ones_among_them():
    """One metric ten times over shows no more than once."""
    departure = Departure(2.2, 4, 27.0, 4.0)
    alone = lack_of_fit([departure], np.ones((1, 1)))
    copied = lack_of_fit([departure] * 10, np.ones((10, 10)))
    independent = lack_of_fit([departure] * 10, np.eye(10))
    assert copied.p_value == pytest.approx(2 * stats.f.sf(2.2, 4, 27))
    assert alone.p_value == pytest.approx(copied.p_value)
    assert not copied.shown
    assert independent.p_value < 0.01


def test_one_metric_that_stands_apart_keeps_its_own_ratio():
    quiet, loud = Departure(1.0, 4, 27.0, 4.0), Departure(40.0, 4, 27.0, 4.0)
    ratios = lack_of_fit([loud, *[quiet] * 9], np.eye(10)).ratios
    assert (ratios[0].value, ratios[0].freedom) == (40.0, 4.0)
    assert all(ratio.value < 10 for ratio in ratios[1:])


@pytest.mark.rest
@pytest.mark.parametrize(("session", "least", "most"), [(0.0, 0.0, 0.096), (0.5, 0.95, 1.0)])
def test_lack_of_fit_is_shown_where_sessions_differ(session, least, most):
    """Level 0.05 of 200 fleets (three standard errors), four metrics; half of the sensors run on all stations."""
    rows = fleet([(n // 20, station, n) for n in range(60) for station in (range(3) if n % 2 else [n % 3])])
    shown = []
    for seed in range(200 if session == 0.0 else 40):
        _, _, lack = find_lack(rows, draw_metrics(rows, seed, 4, session=session))
        shown.append(lack.shown)
    assert least <= np.mean(shown) <= most


def test_a_metric_whose_runs_cancel_in_each_sensor_hides_no_session_of_others():
    """Signs of ±1 at the two stations: the means of a sensor are zero, and so are their residuals."""
    rows = fleet([(number // 4, station, number) for number in range(8) for station in range(2)])
    signs = np.where(rows.sensor % 2, -1.0, 1.0) * np.where(rows.station, -1.0, 1.0)
    random = np.random.default_rng(813)
    disturbed = 0.3 * random.normal(size=16) + 5.0 * ((rows.batch == 1) & (rows.station == 0))
    _, _, lack = find_lack(rows, [signs, disturbed])
    assert lack.shown
