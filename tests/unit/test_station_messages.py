"""What is said of a station file whose instrument tables are wrong: once, by role and driver, with what to do."""

from dataclasses import replace

import pytest

from cbsr_qa.app.setup import configure, open_station, station_clock
from cbsr_qa.domain.errors import CbsrError, ConfigError
from cbsr_qa.plugins import discover


def refused(role, **changes):
    """What opening says of the emulated bench with one of its instrument tables changed."""
    here = configure("bench-emulated", "golden-check", sensor_type=None, material=None, seed=5)
    specs = tuple(replace(spec, **changes) if spec.role == role else spec for spec in here.station.instruments)
    assert specs != here.station.instruments
    here = replace(here, station=replace(here.station, instruments=specs))
    with pytest.raises(CbsrError) as caught:
        open_station(here, discover(), station_clock(here))
    return caught.value


def test_a_misspelt_driver_is_said_as_such_though_its_instrument_is_emulated():
    said = refused("source_meter", driver="keithly-2600")
    assert said.reason == "there is no instrument plugin named 'keithly-2600'"
    assert "did you mean 'keithley-2600'?" in said.remedy


def test_an_address_that_is_none_is_said_with_its_instrument_once():
    said = refused("load_cell", options={"address": "usb:1A867523"})
    assert said.reason == "instrument 'load_cell' (serial-load-cell): address 'usb:1A867523' is no USB device"


def test_two_instruments_of_one_channel_are_refused_with_what_to_do():
    said = refused("load_cell", driver="serial-thermometer", provides=("second_temperature",))
    assert isinstance(said, ConfigError)
    assert said.reason.startswith("channel 'temperature' is sampled by load_cell (serial-thermometer)")
    assert "driver" in said.remedy
