"""Weighted straight lines through strains: certified answers, exclusion, covariance, refusals."""

import numpy as np
import pytest

from cbsr_qa.calibration.fits.quasi_static import fit_quasi_static
from cbsr_qa.domain.errors import NumericsError

STRAINS = np.array([0.05, 0.10, 0.15, 0.20, 0.25, 0.30])


def test_pearsons_data_with_yorks_weights_of_y():
    """Weighted least squares in y against numpy's own, on Pearson's points with York's y weights."""
    x = np.array([0.0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4])
    y = np.array([5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5])
    weight = np.array([1.0, 1.8, 4.0, 8.0, 20.0, 20.0, 70.0, 70.0, 100.0, 500.0])
    fit = fit_quasi_static(x, x, y, 1 / np.sqrt(weight))
    expected, covariance = np.polyfit(x, y, 1, w=np.sqrt(weight), cov="unscaled")
    assert (fit.slope, fit.intercept) == pytest.approx(tuple(expected), rel=1e-10)
    widened = covariance * max(1.0, fit.chi_squared / 8)
    assert fit.covariance == pytest.approx(widened, rel=1e-9)


def test_the_stated_covariance_is_that_seen_over_many_campaigns():
    random = np.random.default_rng(6)
    strain = np.repeat(STRAINS, 10)
    stress = 130 * strain
    found, stated = [], []
    for _ in range(300):
        change = 4.5e-3 * stress + 2e-3 + 0.01 * random.standard_normal(strain.size)
        fit = fit_quasi_static(strain, stress, change, np.full(strain.size, 0.01))
        found.append((fit.slope, fit.intercept))
        stated.append(fit.covariance)
    assert np.mean(found, axis=0) == pytest.approx([4.5e-3, 2e-3], abs=3e-4)
    seen, mean = np.cov(np.array(found).T), np.mean(stated, axis=0)
    # Birge's factor is never below one, so what is stated is a little wide.
    assert np.diag(mean) == pytest.approx(np.diag(seen), rel=0.5)
    assert (np.diag(mean) > 0.85 * np.diag(seen)).all()
    assert mean[0, 1] / np.sqrt(mean[0, 0] * mean[1, 1]) == pytest.approx(
        seen[0, 1] / np.sqrt(seen[0, 0] * seen[1, 1]), abs=0.05
    )


def test_a_strain_that_scatters_more_than_it_changes_is_left_out_and_named():
    strain = np.repeat(STRAINS, 3)
    change = 0.6 * strain
    change[:3] = [-0.05, 0.01, 0.09]
    fit = fit_quasi_static(strain, strain, change)
    assert fit.excluded == (0.05,)
    assert fit.levels == pytest.approx((0.10, 0.15, 0.20, 0.25, 0.30))
    assert fit.slope == pytest.approx(0.6)
    assert "left out: 5 %" in fit.as_parameters("this sensor").slope.source


def test_a_line_that_misses_its_points_is_stated_wider():
    bent = STRAINS**2
    tight = fit_quasi_static(STRAINS, STRAINS, bent, np.full(6, 1e-6))
    assert tight.chi_squared > 100
    assert np.sqrt(tight.covariance[0, 0]) > 0.01


def test_two_strains_are_enough():
    assert fit_quasi_static([0.1, 0.2], [10.0, 20.0], [0.1, 0.2]).slope == pytest.approx(0.01)


def test_a_material_that_does_not_answer_has_a_line_of_zeros():
    fit = fit_quasi_static(STRAINS, STRAINS, 0 * STRAINS)
    assert (fit.slope, fit.intercept) == (0.0, 0.0)
    assert np.isfinite(fit.covariance).all()
    told = fit_quasi_static(STRAINS, STRAINS, 0 * STRAINS, np.full(6, 0.01))
    assert np.sqrt(told.covariance[0, 0]) == pytest.approx(0.01 / np.sqrt(((STRAINS - STRAINS.mean()) ** 2).sum()))


@pytest.mark.parametrize(
    ("strains", "places", "changes", "said"),
    [
        *(
            (STRAINS, x * STRAINS, change * STRAINS, "its square is outside the range of numbers")
            for x, change in ((1.0, 1e-200), (1.0, 1e200), (1e-300, 1.0), (1e100, 1.0))
        ),
        ([0.2, 0.2, 0.2], [20.0, 21.0, 19.0], [0.1, 0.11, 0.09], "1 of 1 strains"),
        ([0.1, 0.2, 0.3], [15.0, 15.0, 15.0], [0.1, 0.2, 0.3], "cannot be told apart"),
        ([0.1, 0.2], [1.0], [0.1, 0.2], "do not fit together"),
    ],
)
def test_what_is_no_line_is_refused(strains, places, changes, said):
    with pytest.raises(NumericsError, match=said):
        fit_quasi_static(strains, places, changes)


def test_parameters_carry_errors_covariance_and_source():
    strain = np.repeat(STRAINS, 4)
    change = 0.6 * strain + 0.01 * np.random.default_rng(1).standard_normal(strain.size)
    fit = fit_quasi_static(strain, strain, change)
    parameters = fit.as_parameters("this sensor")
    assert parameters.slope.value == fit.slope
    assert parameters.slope.stderr == pytest.approx(np.sqrt(fit.covariance[0, 0]))
    assert parameters.covariance == fit.covariance[0, 1] < 0
    assert parameters.slope.source == "this sensor"
