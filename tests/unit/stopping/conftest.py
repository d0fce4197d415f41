"""Signals as an interactive shell hands them down, for the tests of how runs are stopped."""

import signal

import pytest
from stopping import ABORTS


@pytest.fixture(autouse=True)
def _as_at_a_terminal():
    """Signals as an interactive shell hands them down."""
    usual = dict.fromkeys(ABORTS, signal.SIG_DFL) | {signal.SIGINT: signal.default_int_handler}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
