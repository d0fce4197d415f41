"""Budgets of settling times: Student's interval of a mean, and none of lower bounds."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_samples import sample_calibration
from scipy.stats import t as student_t

from cbsr_qa.calibration.uncertainty.settling import evaluate_settling
from cbsr_qa.domain.results.calibration import SettlingSummary


def test_the_mean_of_settled_loads_has_students_interval():
    times_s = np.array([24.1, 26.3, 22.8, 25.0, 23.9])
    summary = SettlingSummary("conductance", True, float(times_s.mean()), float(times_s.std(ddof=1)), 5, 0, 1)
    (expanded,) = evaluate_settling(replace(sample_calibration(), settling=(summary,)))
    low, high = student_t.interval(0.95, 4, times_s.mean(), times_s.std(ddof=1) / np.sqrt(5))
    assert (expanded.mean_s - expanded.U_s, expanded.mean_s + expanded.U_s) == pytest.approx((low, high))
    assert expanded.budget.not_stated == ("clock of the station", "start of the press")


@pytest.mark.parametrize(
    "summary",
    [
        SettlingSummary("conductance", True, 29.5, 3.0, 8, 1, 0),
        SettlingSummary("conductance", True, None, None, 0, 0, 9),
        SettlingSummary("conductance", True, 29.5, 0.0, 1, 0, 0),
    ],
)
def test_lower_bounds_and_single_loads_have_none(summary):
    assert evaluate_settling(replace(sample_calibration(), settling=(summary,))) == ()
