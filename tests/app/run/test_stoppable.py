"""What is worked out after a run is stopped by the first signal, whatever Python makes of it."""

import os
import signal

import pytest
from stopping import dropped

from cbsr_qa.app.run.stopping import stoppable
from cbsr_qa.domain.errors import AbortedError

NUMBERS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


@pytest.mark.parametrize("number", NUMBERS)
def test_it_stops_although_python_dropped_the_first_interrupt(number):
    with pytest.raises(AbortedError, match=number.name), stoppable():
        dropped(number, for_s=5.0)


@pytest.mark.parametrize("number", NUMBERS)
def test_further_signals_do_not_disturb_the_cleaning_up(number):
    steps = []

    def interrupted():
        try:
            os.kill(os.getpid(), number)
        finally:
            for step in range(3):
                os.kill(os.getpid(), number)
                steps.append(step)

    with pytest.raises(AbortedError, match=number.name), stoppable():
        interrupted()
    assert steps == [0, 1, 2]
