"""Fixtures of the tests of instruments that send lines: emulated ones in a world of their own."""

import pytest
from emulated_bench import EmulatedStation
from line_samplers import CELL
from simulated_setting import base_scene, world

from cbsr_qa_plugins.hardware.serial_samplers import open_load_cell


@pytest.fixture(scope="module")
def one_world():
    return world(base_scene())


@pytest.fixture
def make(one_world):
    made = []

    def station(**options):
        made.append(EmulatedStation(one_world, cell=CELL | options, thermometer={"driver": "serial-thermometer"}))
        return made[-1]

    yield station
    for one in made:
        one.close()


@pytest.fixture
def station(make):
    return make()


@pytest.fixture
def cell(station):
    return station.open("cell", open_load_cell)
