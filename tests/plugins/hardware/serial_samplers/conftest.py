"""Fixtures of the tests of instruments that send lines: emulated ones in a world of their own."""

import pytest
from line_samplers import CELL

from cbsr_qa_plugins.hardware.serial_samplers import open_load_cell


@pytest.fixture
def make(stations):
    return lambda **options: stations(cell=CELL | options, thermometer={"driver": "serial-thermometer"})


@pytest.fixture
def station(make):
    return make()


@pytest.fixture
def cell(station):
    return station.open("cell", open_load_cell)
