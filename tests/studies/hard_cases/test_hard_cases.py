"""Every numerically hard case as a test of its own."""

import pytest

from cbsr_qa.studies.hard_cases.case import Ending, examine
from cbsr_qa.studies.hard_cases.stability import CASES

#: Cases that take seconds; others of their areas are in ``make test``.
_SLOW = (
    "contacts-become-1e7-poorer",
    "contacts-next-to-perfect",
    "disc-with-inclusion-of-1e-8",
    "every-singular-value-kept",
    "greit-of-nothing-but-regularisation",
    "inclusion-conducts-1e4-better",
    "inclusion-conducts-1e4-worse",
    "load-of-1e-7-by-local-update",
    "loads-a-nanometre-apart",
    "no-regularisation-tikhonov",
    "noise-over-twelve-decades",
    "regularisation-of-a-millionth",
    "sensitivity-to-perfect-contacts",
    "smooth-image-of-a-small-parameter",
    "smooth-image-of-next-to-no-parameter",
    "total-variation-of-nothing-but-smoothness",
    "two-sided-tolerance-factors",
)


@pytest.mark.parametrize(
    "case", [pytest.param(case, id=case.name, marks=[pytest.mark.rest] * (case.name in _SLOW)) for case in CASES]
)
def test_hard_case(case):
    result = examine(case)
    expected = Ending.OK if case.refuses is None else Ending.REFUSED
    assert result.outcome is expected, result.reason
    if expected is Ending.REFUSED:
        assert result.remedy


def test_names_of_cases_are_unique():
    assert len({case.name for case in CASES}) == len(CASES)
