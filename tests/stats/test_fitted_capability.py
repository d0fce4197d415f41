"""Capability by fitted families, against printed tables, ``scipy.stats``, exact intervals and simulated lots."""

from math import exp, sqrt

import numpy as np
import pytest
from scipy import stats

from benchmarks.fitted_capability import measure
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.fitted_capability import BEST, fitted_capability
from cbsr_qa.stats.fitted_families import COMPARED, FAMILIES
from cbsr_qa.stats.process_capability import capability

#: Gaps between 50 pairs of plates [cm], SAS/QC User's Guide, CAPABILITY procedure, examples 5.9 and 5.11.
GAPS = [
    *(0.746, 0.357, 0.376, 0.327, 0.485, 1.741, 0.241, 0.777, 0.768, 0.409, 0.252, 0.512, 0.534, 1.656, 0.742, 0.378),
    *(0.714, 1.121, 0.597, 0.231, 0.541, 0.805, 0.682, 0.418, 0.506, 0.501, 0.247, 0.922, 0.880, 0.344, 0.519, 1.302),
    *(0.275, 0.601, 0.388, 0.450, 0.845, 0.319, 0.486, 0.529, 1.547, 0.690, 0.676, 0.314, 0.736, 0.643, 0.483, 0.352),
    *(0.636, 1.080),
]
LIMITS = {"lower": 0.3, "upper": 0.8, "confidence": 0.95}


def test_fits_are_those_of_the_guide():
    found = {fit.family: fit for fit in fitted_capability([GAPS], BEST, **LIMITS).compared}
    log_normal, weibull, gamma = (found[name] for name in ("log-normal", "weibull", "gamma"))
    assert log_normal.parameters == pytest.approx({"location": -0.58375, "scale": 0.499546}, rel=2e-5)
    shape_and_scale = 1 / weibull.parameters["scale"], exp(weibull.parameters["location"])
    assert shape_and_scale == pytest.approx((1.961159, 0.719208), rel=2e-6)
    assert gamma.parameters == pytest.approx({"shape": 4.082646, "scale": 0.155198}, rel=3e-6)
    statistics = [fit.anderson_darling for fit in (log_normal, weibull, gamma)]
    assert statistics == pytest.approx([0.24308402, 1.1569354, 0.58106613], rel=1e-7)


def test_indices_and_tests_are_those_of_the_guide():
    """Printed with 3 σ in place of the points of 0.135 and 99.865 %; p of Weibull < 0.010, of gamma 0.137."""
    found = fitted_capability([GAPS], BEST, **LIMITS)
    assert (found.fit.family, found.chosen) == ("log-normal", "least AIC")
    assert (found.pp.value, found.ppk.value) == pytest.approx((0.210804, 0.124927), rel=3e-5)
    assert found.p_value > 0.5
    assert fitted_capability([GAPS], "weibull", **LIMITS).p_value < 0.01
    assert fitted_capability([GAPS], "gamma", **LIMITS).p_value == pytest.approx(0.137, abs=0.05)


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("logistic", stats.logistic),
        ("largest-extreme-value", stats.gumbel_r),
        ("smallest-extreme-value", stats.gumbel_l),
    ],
)
def test_families_with_location_and_scale_are_fitted_as_by_scipy(name, shape):
    assert FAMILIES[name].fit(np.array([GAPS])).ravel() == pytest.approx(shape.fit(GAPS), rel=1e-6)


def test_the_log_logistic_family_is_fitted_as_by_scipy():
    location, scale = FAMILIES["log-logistic"].fit(np.array([GAPS])).ravel()
    shape, _, unit = stats.fisk.fit(GAPS, floc=0)
    assert (1 / scale, exp(location)) == pytest.approx((shape, unit), rel=1e-3)  # the optimiser's tolerance


@pytest.mark.parametrize("name", ["3-parameter-log-normal", "3-parameter-weibull"])
def test_a_threshold_moves_with_the_values(name):
    values, family = np.array([GAPS]), FAMILIES[name]
    moved = family.fit(values + 7.0)
    assert moved.ravel() - (0, 0, 7) == pytest.approx(family.fit(values).ravel(), rel=1e-6)


@pytest.mark.parametrize("limits", [{"upper": 3.0, "lower": None}, {"upper": None, "lower": -2.0}])
def test_normal_values_have_the_interval_of_the_noncentral_t(limits):
    values = stats.norm.ppf((np.arange(30) + 0.5) / 30)
    found = fitted_capability([values], "normal", **limits, confidence=0.9).ppk
    exact = capability([values], **limits, confidence=0.9).ppk
    assert (found.value, found.low, found.high) == pytest.approx((exact.value, exact.low, exact.high), rel=0.02)


def test_parts_per_million_are_the_tails_of_the_family():
    found = fitted_capability([GAPS], "log-normal", **LIMITS)
    tails = stats.lognorm(sqrt(np.var(np.log(GAPS), ddof=1)), scale=exp(np.mean(np.log(GAPS))))
    assert (found.ppm.below, found.ppm.above) == pytest.approx((1e6 * tails.cdf(0.3), 1e6 * tails.sf(0.8)), rel=1e-9)
    assert found.ppm.low < found.ppm.total < found.ppm.high


@pytest.mark.parametrize("name", ["log-normal", "gamma"])
def test_intervals_of_a_named_family_hold(name):
    """Of 60 samples of 30."""
    row = measure(name, 30, 60, others=False)
    assert row.ppk >= 0.85
    assert row.ppm >= 0.85


@pytest.mark.rest
@pytest.mark.parametrize("name", [family.name for family in COMPARED])
def test_intervals_hold_as_the_page_says(name):
    """Of 80 samples of 50; the page has 200."""
    row = measure(name, 50, 80)
    assert row.ppk >= 0.87
    assert row.ppm >= 0.87
    assert row.ppk_chosen >= (0.71 if name == "log-logistic" else 0.83)


@pytest.mark.parametrize(
    ("values", "name", "why"),
    [
        ([1.0] * 12, BEST, "more than half of the values are the same"),
        ([1.0, 2.0, 3.0], BEST, "percentiles need 10 values; there are 3"),
        ([-0.5, *GAPS], "weibull", r"weibull values are above 0; 1 of 51 are not, the least is -0.5"),
        ([0.0, *GAPS], "gamma", r"gamma values are above 0; 1 of 51 are not, the least is 0"),
        (GAPS[:20], "3-parameter-weibull", "a 3-parameter-weibull distribution needs 30 values; there are 20"),
    ],
)
def test_values_that_a_family_cannot_have_are_named(values, name, why):
    with pytest.raises(NumericsError, match=why):
        fitted_capability([values], name, **LIMITS)


def test_values_below_zero_leave_the_families_that_have_them():
    found = fitted_capability([np.array(GAPS) - 1.0], BEST, **LIMITS)
    assert {fit.family for fit in found.compared} == {
        *("normal", "logistic", "largest-extreme-value", "smallest-extreme-value"),
        *("3-parameter-log-normal", "3-parameter-weibull"),
    }
    assert not found.fit.family.startswith("3")


def test_subgroups_that_differ_are_refused():
    with pytest.raises(NumericsError, match="subgroups differ"):
        fitted_capability([GAPS[:25], np.array(GAPS[25:]) + 2], BEST, **LIMITS)
