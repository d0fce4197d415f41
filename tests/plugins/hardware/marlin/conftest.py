"""Fixtures of the tests of the Marlin driver: an emulated printer in a world of its own, and its driver."""

import pytest
from emulated_bench import EmulatedStation
from marlin_printer import TABLE, linked
from simulated_setting import base_scene, world


@pytest.fixture(scope="module")
def one_world():
    return world(base_scene())


@pytest.fixture
def make(one_world):
    made = []

    def station(**options):
        made.append(EmulatedStation(one_world, applicator=TABLE | options))
        return made[-1]

    yield station
    for one in made:
        one.close()


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
