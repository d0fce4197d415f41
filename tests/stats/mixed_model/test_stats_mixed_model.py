"""The mixed model against published fits, balanced closed forms, the same formulas with dense matrices, and truth."""

import json
from importlib import import_module
from math import log, pi, sqrt

import numpy as np
import pytest
from drawn import drawn
from fleet_designs import fleet, three_batches, uneven
from hypothesis import given, strategies as st
from scipy import optimize, stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.crossings import crossing
from cbsr_qa.stats.difference import welch
from cbsr_qa.stats.mixed_model.model import Model, fit
from cbsr_qa.stats.mixed_model.reml import Likelihood, random_effect_sums, small_sample


def dense_covariance(sensor, ratio):
    return np.eye(len(sensor)) + ratio * (sensor[:, None] == sensor[None, :])


def dense_criterion(matrix, values, sensor, ratio):
    """−2 restricted log likelihood from N × N matrices."""
    inverse = np.linalg.inv(dense_covariance(sensor, ratio))
    normal = matrix.T @ inverse @ matrix
    rest = values - matrix @ np.linalg.solve(normal, matrix.T @ inverse @ values)
    freedom = len(values) - matrix.shape[1]
    squares = rest @ inverse @ rest
    determinants = -np.linalg.slogdet(inverse)[1] + np.linalg.slogdet(normal)[1]
    return determinants + freedom * (1 + log(2 * pi * squares / freedom))


def dense_kenward_roger(matrix, sensor, run, between):
    """Kenward & Roger's covariance and information by their formulas, with nothing simplified."""
    parts = [np.eye(len(sensor)), (sensor[:, None] == sensor[None, :]).astype(float)]
    inverse = np.linalg.inv(run * parts[0] + between * parts[1])
    phi = np.linalg.inv(matrix.T @ inverse @ matrix)
    slopes = [-matrix.T @ inverse @ one @ inverse @ matrix for one in parts]
    curves = [[matrix.T @ inverse @ i @ inverse @ j @ inverse @ matrix for j in parts] for i in parts]
    projection = inverse - inverse @ matrix @ phi @ matrix.T @ inverse
    information = [[0.5 * np.trace(projection @ i @ projection @ j) for j in parts] for i in parts]
    weights = np.linalg.inv(information)
    pairs = [(i, j) for i in range(2) for j in range(2)]
    lost = sum(weights[i, j] * (curves[i][j] - slopes[i] @ phi @ slopes[j]) for i, j in pairs)
    return phi, phi + 2 * phi @ lost @ phi, slopes, weights


@pytest.mark.shared
def test_dyestuff_is_lme4s(shared):
    printed = json.loads((shared / "oracle" / "statistics.json").read_text(encoding="utf-8"))["dyestuff"]
    batches = [name for name, values in printed["data"].items() for _ in values]
    values = np.concatenate(list(printed["data"].values())).astype(float)
    found = fit(crossing(["all"] * 30, ["one"] * 30, batches), values)
    assert found.effects[0] == pytest.approx(printed["mean"], rel=1e-14)
    assert found.sensor_deviation**2 == pytest.approx(printed["REML"]["var_batch"], rel=1e-12)
    assert found.run_deviation**2 == pytest.approx(printed["REML"]["var_resid"], rel=1e-12)
    assert found.criterion == pytest.approx(printed["REML_criterion"], abs=5e-5)


@pytest.mark.parametrize("seed", range(4))
def test_the_reduced_problem_is_the_dense_one(seed):
    """Criterion, its minimum, and the profile interval's ends, with 60 × 60 matrices."""
    random = np.random.default_rng([800, seed])
    rows = uneven(random)
    values = rows.values(random, batches=[0, 1, 2], stations=[0, 3, 1], run=0.6)
    found, matrix = fit(rows.design, values), rows.design.columns().toarray()

    def dense(ratio):
        return dense_criterion(matrix, values, rows.sensor, ratio)

    ratio = (found.sensor_deviation / found.run_deviation) ** 2
    assert found.criterion == pytest.approx(dense(ratio), rel=1e-10)
    best = optimize.minimize_scalar(lambda x: dense(np.exp(x)), bounds=(-8, 8), method="bounded")
    assert found.criterion <= best.fun + 1e-8
    assert ratio == pytest.approx(np.exp(best.x), rel=1e-4)
    for end in (found.ratio.low, found.ratio.high):
        if end > 0:
            assert dense(end) - dense(ratio) == pytest.approx(stats.chi2.ppf(0.95, 1), rel=1e-6)


@pytest.mark.parametrize("ratio", [0.0, 0.3, 12.0])
def test_small_sample_terms_are_those_of_the_paper(ratio):
    random = np.random.default_rng(801)
    rows = uneven(random)
    sums = random_effect_sums(rows.design.columns(), random.normal(size=len(rows.sensor)), rows.sensor)
    found, matrix = small_sample(sums, ratio), rows.design.columns().toarray()
    phi, adjusted, slopes, weights = dense_kenward_roger(matrix, rows.sensor, 1.0, ratio)
    assert found.plain == pytest.approx(phi, rel=1e-9)
    assert found.adjusted == pytest.approx(adjusted, rel=1e-9)
    row = np.zeros(matrix.shape[1])
    row[0], row[1] = 1, -1
    gradient = np.array([-row @ phi @ slope @ phi @ row for slope in slopes])
    satterthwaite = 2 * (row @ phi @ row) ** 2 / (gradient @ weights @ gradient)
    assert found.freedom(row) == pytest.approx(satterthwaite, rel=1e-9)


@pytest.mark.parametrize("ratio", [0.0, 0.02, 1.0, 1e4])
def test_slope_is_that_of_the_criterion(ratio):
    random = np.random.default_rng(802)
    rows = uneven(random)
    sums = random_effect_sums(rows.design.columns(), random.normal(size=len(rows.sensor)), rows.sensor)
    likelihood, step = Likelihood(sums), 1e-4 * (ratio + 1e-3)
    ends = likelihood.criterion(np.array([ratio + step, ratio - step]))
    assert likelihood.slope(ratio) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4, abs=1e-7)


def test_nested_and_balanced_is_the_t_test_of_the_sensors_means():
    """Each sensor's three runs on one station: exact, 2 · (10 − 1) degrees of freedom, no adjustment."""
    rows = fleet([(sensor // 10, 0, sensor) for sensor in range(20) for _ in range(3)])
    values = rows.values(np.random.default_rng(803), batches=[0, 1], stations=[0])
    means = values.reshape(20, 3).mean(axis=1)
    found, expected = fit(rows.design, values), welch(means[10:], means[:10])
    contrast = found.group_difference("b001", "b000")
    assert contrast.value == pytest.approx(expected.value, rel=1e-10)
    assert contrast.standard_error == pytest.approx(expected.standard_error, rel=1e-9)
    assert contrast.freedom == pytest.approx(18, rel=1e-8)


def test_complete_blocks_are_the_analysis_of_variance():
    """Every sensor once on every station: stations are judged by the residual, F(3, 33), batches by the sensors."""
    rows = fleet([(sensor % 2, station, sensor) for sensor in range(12) for station in range(4)])
    values = rows.values(np.random.default_rng(804), batches=[0, 1], stations=[0, 1, 2, 0])
    table = values.reshape(12, 4)
    rest = table - table.mean(axis=1, keepdims=True) - table.mean(axis=0) + table.mean()
    residual = float(np.sum(rest**2)) / 33
    found = fit(rows.design, values)
    station = found.station_difference("s001", "s000")
    assert station.value == pytest.approx(float(np.mean(table[:, 1] - table[:, 0])), rel=1e-10)
    assert station.standard_error == pytest.approx(sqrt(2 * residual / 12), rel=1e-9)
    assert station.freedom == pytest.approx(33, rel=1e-8)
    batch, means = found.group_difference("b001", "b000"), table.mean(axis=1)
    assert batch.standard_error == pytest.approx(welch(means[1::2], means[::2]).standard_error, rel=1e-9)
    assert batch.freedom == pytest.approx(10, rel=1e-8)
    assert found.run_deviation == pytest.approx(sqrt(residual), rel=1e-9)


def test_fits_are_statsmodels():
    # Here and not above: seconds of importing that every process of the tests would pay.
    formula = import_module("statsmodels.regression.mixed_linear_model")
    random = np.random.default_rng(806)
    rows = uneven(random, sensors=60)
    values = rows.values(random, batches=[0, 1, 2], stations=[0, 3, 1], run=0.5)
    matrix = rows.design.columns().toarray()
    theirs = formula.MixedLM(values, matrix, groups=rows.sensor).fit(reml=True, method="lbfgs")
    found = fit(rows.design, values)
    assert found.effects[rows.design.independent_columns()] == pytest.approx(theirs.fe_params, rel=1e-5)
    assert found.run_deviation**2 == pytest.approx(theirs.scale, rel=1e-4)
    assert found.sensor_deviation**2 == pytest.approx(float(np.squeeze(theirs.cov_re)), rel=1e-4)


def test_one_run_a_sensor_is_least_squares_and_says_so():
    rows = three_batches(on_all=False)
    values = rows.values(np.random.default_rng(807), batches=[0, 1.5, 0], stations=[1.5, 0, 0])
    found, matrix = fit(rows.design, values), rows.design.columns().toarray()
    assert found.model is Model.FIXED
    assert found.sensor_deviation is found.ratio is found.criterion is None
    assert "cannot be separated" in found.notes[0]
    effects, squares = np.linalg.lstsq(matrix, values, rcond=None)[:2]
    contrast = found.group_difference("b001", "b000")
    assert contrast.value == pytest.approx(effects[1] - effects[0], rel=1e-9)
    assert contrast.freedom == 55
    assert found.run_deviation == pytest.approx(sqrt(squares[0] / 55), rel=1e-9)


def test_no_sensor_variance_is_the_boundary():
    """Runs that differ more than chance lets sensors: θ = 0, its interval starts there, and degrees stay finite."""
    rows = fleet([(sensor // 5, 0, sensor) for sensor in range(10) for _ in range(2)])
    values = np.tile([1.0, -1.0], 10) + 0.01 * np.random.default_rng(808).normal(size=20)
    found = fit(rows.design, values)
    assert found.sensor_deviation == found.ratio.low == 0.0
    assert 0 < found.ratio.high < 1
    assert any("estimated as zero" in note for note in found.notes)
    assert 0 < found.group_difference("b001", "b000").freedom < 20


@drawn(30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-6, 2.0, 1e8]), st.sampled_from([-1e4, 0.0, 7.0]))
def test_units_origins_orders_and_names_change_nothing(seed, scale, origin):
    random = np.random.default_rng(seed)
    rows = uneven(random)
    values = rows.values(random, batches=[0, 1, 2], stations=[0, 3, 1])
    here = fit(rows.design, values).group_difference("b002", "b000")
    order = random.permutation(len(values))
    design = crossing(
        [f"batch {9 - number}" for number in rows.batch[order]],
        [f"{number}" for number in (rows.station[order] + 1) % 3],
        [f"{hash((7, int(number)))}" for number in rows.sensor[order]],
    )
    there = fit(design, scale * (values[order] + origin)).group_difference("batch 7", "batch 9")
    assert there.value == pytest.approx(scale * here.value, rel=1e-6, abs=1e-6 * scale)
    assert there.standard_error == pytest.approx(scale * here.standard_error, rel=1e-5)
    assert there.freedom == pytest.approx(here.freedom, rel=1e-4)


def test_a_batch_that_only_its_station_saw_is_not_compared():
    rows = fleet([(batch, station, sensor) for batch, station, sensor in PARTS])
    found = fit(rows.design, rows.values(np.random.default_rng(809), batches=[0, 1, 9], stations=[0, 1, 9]))
    reason = r"b002 and b000 cannot be compared: b002 ran on s002 only and b000, b001 on s000, s001 only"
    with pytest.raises(NumericsError, match=reason):
        found.group_difference("b002", "b000")
    with pytest.raises(NumericsError, match="stations s002 and s000 cannot be compared"):
        found.station_difference("s002", "s000")
    assert found.group_difference("b001", "b000").value == pytest.approx(1.0, abs=1.5)
    assert any("b002 on s002: not compared" in note for note in found.notes)


#: Batches 0 and 1 share stations 0 and 1; batch 2 and station 2 have only each other.
PARTS = [
    (batch, station, 4 * batch + sensor)
    for batch, stations in ((0, (0, 1)), (1, (0, 1)), (2, (2,)))
    for sensor in range(4)
    for station in stations
]


def test_a_batch_on_one_station_is_compared_through_the_others_and_named():
    rows = fleet([(0, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 1), (1, 1, 2), (1, 1, 3), (1, 1, 4)])
    found = fit(rows.design, rows.values(np.random.default_rng(810), batches=[0, 1], stations=[0, 5]))
    assert any("b001 ran on s001 only" in note for note in found.notes)
    assert found.group_difference("b001", "b000").value == pytest.approx(1.0, abs=4)


def test_the_stations_offset_is_not_the_batches():
    """However large a station's offset, the estimate does not move: the naive difference does, by much of it."""
    rows = three_batches(on_all=True)
    values = rows.values(np.random.default_rng(811), batches=[0, 1.5, 0], stations=[0, 0, 0])
    moved = values + 1000.0 * (rows.station == 0)
    here, there = (fit(rows.design, y).group_difference("b001", "b000").value for y in (values, moved))
    assert there == pytest.approx(here, abs=1e-7)
    naive = [welch(y[rows.batch == 1], y[rows.batch == 0]).value for y in (values, moved)]
    assert abs(naive[1] - naive[0]) > 20


@pytest.mark.rest
@pytest.mark.parametrize("on_all", [False, True])
def test_fleets_of_known_truth(on_all):
    """A sample of 200 seeds: the intervals cover, the batch is found, and its station is not."""
    rows, covered, found, naive = three_batches(on_all=on_all), [], 0, []
    design = rows.design
    for seed in range(200):
        values = rows.values(np.random.default_rng([812, seed]), batches=[0, 1.5, 0], stations=[1.5, 0, 0])
        model = fit(design, values)
        for second, truth in (("b000", 1.5), ("b002", 1.5)):
            interval = model.group_difference("b001", second).interval()
            covered.append(interval.holds(truth))
            found += interval.low > 0
        covered.append(model.group_difference("b002", "b000").interval().holds(0.0))
        naive.append(welch(values[rows.batch == 2], values[rows.batch == 0]).interval().holds(0.0))
    assert 0.92 <= np.mean(covered) <= 0.98  # 600 intervals of 95 %, three to a fleet
    assert found / 400 >= 0.95
    assert np.mean(naive) < 0.9  # what a plain t test claims of two batches that are alike


@pytest.mark.parametrize(
    ("rows", "values", "reason"),
    [
        ([(0, 0, 0), (0, 1, 0), (0, 0, 0)], [1.0, 2.0, 4.0], "1 sensors are too few to judge 2"),
        # One sensor a batch: its values do differ, and nothing is left to judge them by.
        ([(0, 0, 0), (1, 0, 1)], [1.0, 2.0], "2 sensors are too few to judge 2"),
        ([(0, 0, 0), (0, 0, 1), (1, 0, 2)], [1.0, 1.0, 2.0], "values do not differ within groups"),
        ([(0, 0, 0), (0, 0, 1), (1, 0, 2)], [3.0, 3.0, 3.0], "all 3 values are 3"),
        ([(0, 0, 0), (0, 0, 1), (1, 0, 2)], [3.0, np.nan, 3.0], "1 of 3 values are missing"),
        ([(0, 0, 0), (0, 0, 1)], [3.0], "1 values for 2 runs"),
    ],
)
def test_what_cannot_be_fitted_is_named(rows, values, reason):
    with pytest.raises(NumericsError, match=f"E_CoM: .*{reason}"):
        fit(fleet(rows).design, np.array(values), "E_CoM")


def test_few_repeats_are_named():
    rows = fleet([(sensor % 2, 0, sensor) for sensor in [*range(12), 0, 1]])
    found = fit(rows.design, rows.values(np.random.default_rng(814), batches=[0, 1], stations=[0]))
    assert "2 repeated runs" in found.notes[0]


def test_runs_that_do_not_differ_leave_their_first():
    rows = fleet([(sensor // 4, 0, sensor) for sensor in range(8) for _ in range(2)])
    once = np.random.default_rng(813).normal(size=8)
    found = fit(rows.design, np.repeat(once, 2))
    assert found.model is Model.FIXED
    assert "runs of one sensor do not differ" in found.notes[0]
    assert found.group_difference("b001", "b000").freedom == 6


def test_designs_that_are_none_are_named():
    with pytest.raises(NumericsError, match="0 groups, 0 stations, 0 sensors"):
        crossing([], [], [])
    with pytest.raises(NumericsError, match="run at index 1 has no station"):
        crossing(["a", "a"], ["s", ""], ["1", "2"])
    with pytest.raises(NumericsError, match="2 groups, 1 stations"):
        crossing(["a", "a"], ["s"], ["1", "2"])
    design = crossing(["a", "b", "a"], ["s", "s", "s"], ["1", "1", "2"])
    assert design.select_runs(np.array([True, False, True])).groups == ("a",)
    with pytest.raises(NumericsError, match="no used run has group 'c'; used are a, b"):
        design.index("group", "c")
