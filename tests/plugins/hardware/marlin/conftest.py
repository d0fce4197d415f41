"""Fixtures of the tests of the Marlin driver: an emulated printer in a world of its own, and its driver."""

import pytest
from marlin_printer import TABLE, linked


@pytest.fixture
def make(stations):
    return lambda **options: stations(applicator=TABLE | options)


@pytest.fixture
def station(make):
    return make()


@pytest.fixture
def head(station):
    """An applicator that is linked with a force but has not homed."""
    return linked(station)


@pytest.fixture
def homed(head):
    head.home()
    return head
