"""Safety: the states of a bench, and which may follow which."""

import pytest

from cbsr_qa.domain.errors import SafetyError
from cbsr_qa.station.safety import TRANSITIONS, Interlock, State


def test_every_state_can_be_stopped_from_and_only_stopping_ends():
    for state, following in TRANSITIONS.items():
        ends = state in (State.STOPPING, State.SAFE, State.UNSAFE)
        assert (State.STOPPING in following) != ends
        assert bool(following & {State.SAFE, State.UNSAFE}) == (state is State.STOPPING)
    assert set(TRANSITIONS) == set(State)


def test_no_way_leads_from_a_touching_state_to_travel_but_through_release():
    for state in (State.PRESSING, State.PRESSED, State.EASING):
        assert not TRANSITIONS[state] & {State.ARMED, State.MOVING}
    assert State.MOVING not in TRANSITIONS[State.RELEASING]


@pytest.mark.parametrize("state", list(State))
def test_transitions_that_are_not_listed_are_refused(state):
    interlock = Interlock()
    interlock.state = state
    for other in set(State) - TRANSITIONS[state]:
        with pytest.raises(SafetyError, match=f"is {state}"):
            interlock.to(other)


def test_an_error_leaves_the_state_it_happened_in():
    interlock = Interlock()
    interlock.to(State.CLEARING)
    interlock.to(State.ARMED)
    with pytest.raises(OSError, match="x"), interlock.passing(State.PRESSING, State.PRESSED):
        raise OSError("x")
    assert interlock.state is State.PRESSING
    assert interlock.touching


@pytest.mark.parametrize(("silent", "end"), [((), State.SAFE), (("frame_source: no answer",), State.UNSAFE)])
def test_a_stop_ends_safe_where_every_instrument_got_there_and_nowhere_else(silent, end):
    class Stopped:
        def safe_state(self):
            return silent

    interlock = Interlock()
    assert interlock.stop(Stopped()) == silent
    assert interlock.state is end
