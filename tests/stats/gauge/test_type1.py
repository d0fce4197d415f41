"""Type 1 gauge studies: definitions, intervals by simulation, and what is refused."""

import numpy as np
import pytest

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.gauge.type1 import CAPABLE, study_type1

_READINGS = [10.0, 10.02, 9.98, 10.01, 9.99, 10.03, 9.97, 10.0, 10.02, 9.98]


def test_indices_are_as_they_are_defined():
    study = study_type1(_READINGS, 9.99, 1.5)
    deviation = np.std(_READINGS, ddof=1)
    assert study.cg.value == pytest.approx(0.2 * 1.5 / (6 * deviation), rel=1e-12)
    assert study.cgk.value == pytest.approx((0.1 * 1.5 - 0.01) / (3 * deviation), rel=1e-12)
    assert study_type1(_READINGS, np.mean(_READINGS), 1.5).cgk.value == pytest.approx(study.cg.value, rel=1e-9)


def test_a_bias_beyond_a_tenth_of_the_tolerance_makes_cgk_negative():
    study = study_type1(_READINGS, 10.3, 1.5)
    assert study.cgk.value < 0 < study.cg.value
    assert study.capable() is False


def test_what_is_not_shown_is_neither_capable_nor_not():
    deviation = np.std(_READINGS, ddof=1)
    just = study_type1(_READINGS, 10.0, 6 * deviation * 1.5 / 0.2)
    assert just.cg.value == pytest.approx(1.5)
    assert just.cg.low < CAPABLE
    assert just.capable() is None
    assert study_type1(_READINGS, 10.0, 6 * deviation * 4 / 0.2).capable() is True


@pytest.mark.parametrize("uncertainty", [0.0, 0.5])
def test_intervals_hold_the_truth(uncertainty):
    """Deviation 1, bias 0.5, tolerance 60: Cg = 2, Cgk = 5.5/3; the reference errs as it is stated to."""
    random = np.random.default_rng(31)
    held = []
    for _ in range(600):
        stated = 100 + uncertainty * random.standard_normal()
        study = study_type1(100.5 + random.standard_normal(30), stated, 60.0, uncertainty=uncertainty)
        held.append((study.cg.low <= 2.0 <= study.cg.high, study.cgk.low <= 5.5 / 3 <= study.cgk.high))
    of_cg, of_cgk = np.mean(held, axis=0)
    assert of_cg == pytest.approx(0.95, abs=0.03)
    assert of_cgk >= 0.92
    if not uncertainty:
        assert of_cgk <= 0.98


@pytest.mark.parametrize(
    ("readings", "tolerance", "uncertainty"),
    [(_READINGS[:9], 1.0, 0.0), ([10.0] * 10, 1.0, 0.0), (_READINGS, 0.0, 0.0), (_READINGS, 1.0, -0.1),
     ([*_READINGS, np.nan], 1.0, 0.0)],
)  # fmt: skip
def test_what_says_nothing_is_refused(readings, tolerance, uncertainty):
    with pytest.raises(NumericsError):
        study_type1(readings, 10.0, tolerance, uncertainty=uncertainty)
