"""What a station is doing, from its run's channel, the store and the processes that are alive."""

from dataclasses import replace
from datetime import UTC, datetime

from cbsr_qa.domain.results import EndReason
from cbsr_qa.store.runs import RunLook
from cbsr_qa.web.state import Mode, control_of, mode_of

_AT = datetime(2026, 3, 1, 8, tzinfo=UTC)
_LOOK = RunLook("r-1", "S-1", "", "bench", "nine", "Ada", _AT, EndReason.FINISHED, "", None, "", calibrated=False)
_HELLO = {"run": None, "serial": "S-1", "recipe": "nine"}


def _control(**state):
    return control_of(_HELLO, {"remaining_s": 60.0, "clock_speed": 1.0, **state}, down=False)


def test_a_page_that_was_there_before_the_run_had_a_name_sees_it_end():
    stored = replace(_LOOK, run="r-0")
    assert mode_of(_control(run=None), stored, held=True, starting=True) is Mode.RUNNING
    assert mode_of(_control(run="r-1"), _LOOK, held=True, starting=True) is Mode.CONCLUDING
