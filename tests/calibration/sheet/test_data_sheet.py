"""Data-sheet arithmetic: certified values, exact solutions, and stated errors held against scatter."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.optimize import linprog

from cbsr_qa.calibration.fits.estimates import (
    best_straight_line,
    pool_deviations,
    ratio_of_sums,
    relative_spread,
    slope,
    terminal_line,
)
from cbsr_qa.domain.errors import NumericsError

#: NIST StRD, analysis of variance, SiRstv: five instruments, five readings each; certified residual deviation.
SIRSTV = (
    (196.3052, 196.1240, 196.1890, 196.2569, 196.3403),
    (196.3042, 196.3825, 196.1669, 196.3257, 196.0422),
    (196.1303, 196.2005, 196.2889, 196.0343, 196.1811),
    (196.2795, 196.1748, 196.1494, 196.1485, 195.9885),
    (196.2119, 196.1051, 196.1850, 196.0052, 196.2090),
)

finite = st.floats(-100, 100)
curves = st.lists(st.tuples(st.integers(0, 300), finite), min_size=3, max_size=9, unique_by=lambda point: point[0])


def test_the_pooled_deviation_is_nists():
    found = pool_deviations(SIRSTV)
    assert found.value == pytest.approx(1.04076068334656e-01, rel=1e-10)
    assert found.degrees == 20
    assert found.stderr == pytest.approx(found.value / np.sqrt(40))


def test_single_values_say_nothing_about_scatter():
    alone = [(3.0,), (4.0,)]
    assert pool_deviations([*SIRSTV, *alone]) == pool_deviations(SIRSTV)
    with pytest.raises(NumericsError, match="nothing was pressed twice"):
        pool_deviations(alone)


@given(curve=curves)
def test_no_line_is_better_than_the_best_straight_line(curve):
    """Against the linear programme: smallest h with |y − a x − b| ≤ h."""
    x, y = np.array(curve, dtype=float).T
    line = best_straight_line(x.tolist(), y.tolist())
    rows = np.column_stack([x, np.ones_like(x), -np.ones_like(x)])
    bounds = [(None, None), (None, None), (0, None)]
    other = linprog([0, 0, 1], np.vstack([rows, rows * [-1, -1, 1]]), np.concatenate([y, -y]), bounds=bounds)
    assert line.largest == pytest.approx(other.fun, abs=1e-6)
    assert np.abs(line.deviations).max() == line.largest
    assert line.deviations == pytest.approx(y - line.slope * x - line.intercept, abs=1e-9)


@given(curve=curves, tilt=finite, lift=finite)
def test_a_straight_part_is_no_nonlinearity(curve, tilt, lift):
    x, y = np.array(curve, dtype=float).T
    for draw in (best_straight_line, terminal_line):
        plain, tilted = draw(x.tolist(), y.tolist()), draw(x.tolist(), (y + tilt * x + lift).tolist())
        assert tilted.largest == pytest.approx(plain.largest, abs=1e-8)
        assert tilted.slope == pytest.approx(plain.slope + tilt, abs=1e-8)


@given(curve=curves)
def test_the_terminal_line_is_at_most_twice_as_far(curve):
    x, y = (list(part) for part in zip(*curve, strict=True))
    best, terminal = best_straight_line(x, y).largest, terminal_line(x, y).largest
    assert best <= terminal + 1e-9
    assert terminal <= 2 * best + 1e-9


def test_a_parabola_leaves_its_lines_by_an_eighth_and_a_quarter():
    """x² between −1 and 1: ½ from the best line, 1 from the chord."""
    x = np.linspace(-1, 1, 9)
    best, chord = (draw(x.tolist(), (x**2).tolist()) for draw in (best_straight_line, terminal_line))
    assert (best.largest, best.slope, best.intercept) == (pytest.approx(0.5), pytest.approx(0), pytest.approx(0.5))
    assert (chord.largest, chord.slope, chord.intercept) == (pytest.approx(1.0), pytest.approx(0), pytest.approx(1.0))


@pytest.mark.parametrize("draw", [best_straight_line, terminal_line])
def test_the_error_of_the_largest_deviation_is_its_scatter(draw):
    """Of a curve on which the points that decide are clear; where several compete it is on the safe side."""
    x, error = np.linspace(5, 40, 7), np.array([0.01, 0.02, 0.01, 0.02, 0.01, 0.02, 0.01])
    clean, rng = 0.1 * x + 0.004 * x**2, np.random.default_rng(4)
    seen = [draw(x.tolist(), (clean + error * rng.standard_normal(7)).tolist()).largest for _ in range(2000)]
    assert np.std(seen) == pytest.approx(draw(x.tolist(), clean.tolist(), error.tolist()).stderr, rel=0.1)


@pytest.mark.parametrize(
    ("x", "y", "said"),
    [
        ([1, 2], [1, 2], "needs 3 to 100 strains; there are 2"),
        ([1, 2, 2], [1, 2, 3], "same stress"),
        ([1, 2, 3], [1, 2], "do not fit together"),
    ],
)
def test_what_is_no_characteristic_is_refused(x, y, said):
    for draw in (best_straight_line, terminal_line):
        with pytest.raises(NumericsError, match=said):
            draw(x, y)


def test_a_ratio_of_sums_weighs_by_size_and_knows_its_error():
    assert ratio_of_sums([1.0, 2.0], [10.0, 20.0]).value == pytest.approx(0.1)
    assert ratio_of_sums([1.0, 2.0], [10.0, 20.0]).stderr == pytest.approx(0.0, abs=1e-15)
    assert ratio_of_sums([1.0], [4.0]).stderr is None
    rng, whole = np.random.default_rng(5), np.linspace(1, 6, 60)
    found = [ratio_of_sums(0.3 * whole + 0.1 * rng.standard_normal(60), whole) for _ in range(2000)]
    assert np.mean([f.value for f in found]) == pytest.approx(0.3, abs=0.001)
    assert np.mean([f.stderr for f in found]) == pytest.approx(np.std([f.value for f in found]), rel=0.06)
    for parts, wholes, said in (([], [], "no share can be computed"), ([1], [-1], "sum to -1"), ([1], [], "1 parts")):
        with pytest.raises(NumericsError, match=said):
            ratio_of_sums(parts, wholes)


def test_a_spread_knows_its_error():
    rng = np.random.default_rng(6)
    found = [relative_spread(10 + 2 * rng.standard_normal(39)) for _ in range(2000)]
    assert np.mean([f.value for f in found]) == pytest.approx(0.2, rel=0.02)
    assert np.mean([f.stderr for f in found]) == pytest.approx(np.std([f.value for f in found]), rel=0.06)
    with pytest.raises(NumericsError, match="2 of them gave a value"):
        relative_spread([1.0, 2.0])
    with pytest.raises(NumericsError, match="mean over the locations"):
        relative_spread([-1.0, 0.0, 1.0])


def test_a_slope_on_a_huge_offset_keeps_its_digits():
    x, y = 1e6 + np.array([0.1, 0.7, 2.2, 3.1]), 1e9 + np.array([0.0, 1.0, 2.0, 3.0])
    exact = np.polyfit((x - 1e6), (y - 1e9), 1)[0]
    assert slope(x.tolist(), y.tolist()).value == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("draw", [best_straight_line, terminal_line])
def test_deviations_from_a_line_far_from_zero_keep_their_digits(draw):
    x, y = np.arange(5.0), np.arange(5.0) ** 2 / 1024
    near, far = draw(x.tolist(), (0.75 * x + y).tolist()), draw((2.0**20 + x).tolist(), (0.75 * x + y).tolist())
    np.testing.assert_array_equal(far.deviations, near.deviations)


def test_a_slope_is_that_of_least_squares():
    rng = np.random.default_rng(7)
    x, y = rng.uniform(0, 0.3, 12), rng.uniform(0, 40, 12)
    line, covariance = np.polyfit(x, y, 1, cov=True)
    found = slope(x, y)
    assert found.value == pytest.approx(line[0])
    assert found.stderr == pytest.approx(np.sqrt(covariance[0, 0]))
    assert slope([0.1, 0.2], [1.0, 3.0]).stderr is None
    with pytest.raises(NumericsError, match="two strains"):
        slope([0.2, 0.2, 0.2], [1.0, 2.0, 3.0])
