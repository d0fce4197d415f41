"""A clock that was set while a run was measured is named, and a correction by seconds is not."""

from datetime import timedelta

import pytest

from cbsr_qa.app.run.session import clock_warning


@pytest.mark.parametrize(
    ("moved", "said"),
    [
        (timedelta(seconds=59), ""),
        (timedelta(seconds=-59), ""),
        (timedelta(hours=-2.5), "was set back by 2 h 30 min while the run was measured, or the computer slept"),
        (timedelta(days=365), "was set forward by 8760 h while the run was measured"),
    ],
)
def test_what_is_said_of_a_clock_that_was_set(moved, said):
    assert said in clock_warning(moved)
    assert bool(said) is bool(clock_warning(moved))
