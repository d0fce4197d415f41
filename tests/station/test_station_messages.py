"""What is said of a station file whose instrument tables are wrong: once, by role and driver, with what to do."""

from dataclasses import replace

import pytest

from cbsr_qa.domain.errors import CbsrError, ConfigError
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.station.setup import configure, open_station, station_clock


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
    assert said.reason == "instrument 'load_cell' (serial-load-cell): address 'usb:1A867523' is not a USB device"


@pytest.mark.parametrize(
    ("role", "changes", "samples", "near"),
    [
        ("load_cell", {"provides": ("forse",)}, "it samples 'force'", "'force'"),
        ("load_cell", {"provides": ("force", "temperature")}, "it samples 'force'", ""),
        ("load_cell", {"driver": "serial-thermometer"}, "it samples 'temperature'", ""),
        ("multiplexer", {"provides": ("multiplexr",)}, "it samples nothing", "'multiplexer'"),
    ],
)
def test_a_role_that_nobody_knows_is_refused_with_the_nearest(role, changes, samples, near):
    said = refused(role, **changes)
    assert isinstance(said, ConfigError)
    assert said.reason.startswith(f"instrument {role} (")
    assert said.reason.endswith(f"which is neither a role nor what it samples: {samples}")
    assert said.remedy.startswith(f"did you mean {near}? roles: frame_source" if near else "roles: frame_source")
