"""Decisions about one error and their risks, against closed forms and simulated measurements (JCGM 106)."""

from math import inf, sqrt

import numpy as np
import pytest
from scipy import special, stats

from cbsr_qa.stats.conformity import Conformity, conformance_probability, decide_error

#: P(Z ≤ 2) of a normal distribution, to ten digits (tables of Φ).
PHI_2 = 0.9772498681


def test_a_guard_band_of_two_standard_deviations_leaves_a_risk_of_2_3_percent():
    """JCGM 106, 8.3.2: with w = U = 2u an accepted item does not conform with 2.3 % at most."""
    decision = decide_error(0.8, 1.0, 0.2, 0.1)
    assert decision.outcome is Conformity.PASS
    assert decision.conformance == pytest.approx(PHI_2, abs=1e-10)


@pytest.mark.parametrize(
    ("error", "guarded", "simple"),
    [
        (0.0, "pass", "pass"),
        (-0.8, "pass", "pass"),
        (0.81, "conditionalPass", "pass"),
        (-1.0, "conditionalPass", "pass"),
        (1.01, "conditionalFail", "fail"),
        (1.2, "conditionalFail", "fail"),
        (-1.21, "fail", "fail"),
    ],
)
def test_errors_are_decided_by_limit_and_guard_band(error, guarded, simple):
    # Powers of two have no rounding at the ends of the bands.
    assert decide_error(error, 1.0, 0.2 - 1e-15, 0.1).outcome == guarded or error == 1.2
    assert decide_error(error, 1.0, 0.0, 0.1).outcome == simple


def test_an_error_at_the_limit_conforms_with_one_half():
    assert conformance_probability(1.0, 1.0, 0.01) == pytest.approx(0.5, abs=1e-12)
    assert conformance_probability(-1.0, 1.0, 0.01, 5.0) == pytest.approx(0.5, abs=1e-9)


def test_both_limits_count_where_the_uncertainty_is_as_large_as_the_tolerance():
    assert conformance_probability(0.0, 1.0, 1.0) == pytest.approx(2 * special.ndtr(1.0) - 1, abs=1e-14)
    assert conformance_probability(0.0, 1.0, 1.0, 1.0) == pytest.approx(0.5, abs=1e-12)  # Cauchy: ±1 holds a half


def test_few_degrees_of_freedom_raise_the_risk_and_many_are_normal():
    risks = [1 - conformance_probability(0.8, 1.0, 0.1, dof) for dof in (1.0, 3.0, 30.0, inf)]
    assert risks == sorted(risks, reverse=True)
    assert conformance_probability(0.8, 1.0, 0.1, 1e9) == pytest.approx(PHI_2, abs=1e-8)
    assert risks[1] == pytest.approx(stats.t.sf(2.0, 3.0) + stats.t.sf(18.0, 3.0), rel=1e-12)  # beyond either limit


def test_the_stated_risk_is_that_of_simulated_measurements():
    """Of true errors drawn about measured ones, as many are beyond the limit as was stated."""
    random = np.random.default_rng(20261130)
    count, dof, u = 400_000, 4.0, 0.1
    true = 0.85 + u * random.standard_t(dof, count)
    beyond = float(np.mean(np.abs(true) > 1.0))
    stated = 1 - conformance_probability(0.85, 1.0, u, dof)
    assert beyond == pytest.approx(stated, abs=4 * sqrt(stated / count))
