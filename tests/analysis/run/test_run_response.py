"""Which way the conductance goes under load."""

import pytest
from hypothesis import given, strategies as st

from cbsr_qa.analysis.run.imaging import decide_response
from cbsr_qa.domain.sensor.sensor_type import Response


@pytest.mark.parametrize(
    ("signals", "response"), [([0.1, 0.2], Response.INCREASE), ([-0.1, -0.2, 0.001], Response.DECREASE)]
)
def test_auto_follows_the_loads(signals, response):
    decided, how, warnings = decide_response(Response.AUTO, signals, noise_floor=0.01)
    assert decided is response
    assert "decided from 2 loads" in how
    assert warnings == ()


def test_loads_that_disagree_are_a_warning():
    decided, _, warnings = decide_response(Response.AUTO, [0.1, 0.1, -0.1], noise_floor=0.01)
    assert decided is Response.INCREASE
    assert "disagree" in warnings[0]


def test_noise_decides_nothing():
    _, how, warnings = decide_response(Response.AUTO, [0.001, -0.002], noise_floor=0.01)
    assert "not decided" in how
    assert warnings


def test_a_configured_response_stays_but_contradiction_is_said():
    decided, how, warnings = decide_response(Response.DECREASE, [0.1, 0.2], noise_floor=0.01)
    assert decided is Response.DECREASE
    assert "configured" in how
    assert "2 loads raise" in warnings[0]


@given(st.lists(st.floats(-1, 1), max_size=9), st.floats(1e-6, 0.1))
def test_turning_every_signal_turns_the_decision(signals, floor):
    ahead, _, _ = decide_response(Response.AUTO, signals, floor)
    turned, _, _ = decide_response(Response.AUTO, [-s for s in signals], floor)
    clear = [s for s in signals if abs(s) > floor / 3]
    tie = sum(s > 0 for s in clear) * 2 == len(clear)
    assert (ahead is not turned) or tie
