"""Every numerically hard case as a test of its own."""

import pytest

from cbsr_qa.studies.hard_cases.case import Ending, examine
from cbsr_qa.studies.hard_cases.stability import CASES


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_hard_case(case):
    result = examine(case)
    expected = Ending.OK if case.refuses is None else Ending.REFUSED
    assert result.outcome is expected, result.reason
    if expected is Ending.REFUSED:
        assert result.remedy
