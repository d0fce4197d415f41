"""The station files of the page on building the bench are read, and their tables are what the drivers take."""

import re
from pathlib import Path

import pytest

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.station.setup import check_clock, configure, opener, station_clock

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "build-this-bench.md").read_text()
WHOLE, PHIDGET, BOARD, BY_HAND = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)
HEAD, *_ = WHOLE.partition("[instruments.")
STATIONS = {
    "the whole bench": WHOLE,
    "with the board": BOARD.join(
        re.split(r"\[instruments\.source_meter\].*(?=\[instruments\.applicator\])", WHOLE, maxsplit=1, flags=re.S)
    ),
    "with the rig's load cell": PHIDGET.join(
        re.split(r"\[instruments\.load_cell\].*(?=\[instruments\.thermometer\])", WHOLE, maxsplit=1, flags=re.S)
    ),
    "by hand": HEAD.replace("temperature_C", "#") + BOARD + BY_HAND,
}
ABSENT = (
    r"no such device is plugged in|there is no port|does not answer|no Marlin printer answers|refused|unreachable"
    r"|needs the library Phidget22|attach"
)


@pytest.mark.parametrize("name", STATIONS)
def test_its_tables_are_taken_and_only_the_instruments_are_missing(name, tmp_path):
    (tmp_path / "my-bench.toml").write_text(STATIONS[name].replace("192.168.0.5::5025", "127.0.0.1::9"))
    configuration = configure(
        str(tmp_path / "my-bench.toml"), "nine-locations", sensor_type=None, material=None, seed=1
    )
    opened, _ = opener(configuration, discover(), station_clock(configuration), ask=lambda text: "")
    there, absent = [], []
    for spec in configuration.station.instruments:
        try:
            there.append(opened(spec).identity().driver)
        except (InstrumentError, ConfigError) as error:
            absent.append(error.reason)
    assert all(re.search(ABSENT, reason) for reason in absent), absent
    assert len(absent) + len(there) == len(configuration.station.instruments)
    alone = {
        "the whole bench": ["scanned-frames"],
        "with the rig's load cell": ["scanned-frames"],
        "with the board": [],
    }
    assert sorted(there) == alone.get(name, ["manual-applicator", "manual-load-cell"])


def test_it_says_plainly_what_software_limits_are_not():
    assert "**Software limits are not a safety-rated stop.**" in PAGE


@pytest.mark.parametrize(
    ("station", "remedy"), [("bench-emulated", "two station files"), ("simulated", 'clock = "real"')]
)
def test_a_real_instrument_on_a_virtual_clock_is_refused_with_what_can_be_done(station, remedy):
    """A station that emulates others cannot have a real clock either."""
    configuration = configure(station, "nine-locations", sensor_type=None, material=None, seed=1)
    there = InstrumentIdentity("load_cell", "serial-load-cell", "cell", "", "", simulated=False)
    with pytest.raises(ConfigError, match="load_cell is a real instrument") as refused:
        check_clock(configuration, [there])
    assert remedy in refused.value.remedy
