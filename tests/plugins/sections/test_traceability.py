"""What a run of a composed bench can be traced to: every instrument, where it is, and what was done to it."""

from dataclasses import replace
from importlib.metadata import version

import pytest

from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.software import software_versions
from cbsr_qa.station.setup import configure, open_station, station_clock
from cbsr_qa_plugins.sections.traceability import Traceability

PLUGINS = discover()


@pytest.fixture(scope="module")
def instruments():
    """Those of the shipped emulated bench, its load cell tared, its meter with a calibration date."""
    found = configure("bench-emulated", "golden-check", sensor_type=None, material=None, seed=1)
    specs = tuple(
        replace(
            spec,
            options={**spec.options, **({"tare_s": 2.0} if spec.role == "load_cell" else {})},
            calibration_due="2027-03-31" if spec.role == "source_meter" else None,
        )
        for spec in found.station.instruments
    )
    configuration = replace(found, station=replace(found.station, instruments=specs))
    bench = open_station(configuration, PLUGINS, station_clock(configuration))
    try:
        return {one.role: one for one in bench.identities()}
    finally:
        bench.safe_state()
        bench.close()


def test_every_instrument_of_the_station_file_says_who_it_is(instruments):
    assert set(instruments) == {"applicator", "frames", "load_cell", "multiplexer", "source_meter", "thermometer"}
    assert all(one.driver and one.model and one.simulated for one in instruments.values())
    meter = instruments["source_meter"]
    assert "2634B" in meter.model
    assert (meter.serial, meter.calibration_due) != ("", None)
    assert meter.firmware


def test_where_it_is_and_what_was_done_to_it_are_notes(instruments):
    notes = {role: dict(one.notes) for role, one in instruments.items()}
    for role in set(notes) - {"frames"}:  # those are scanned through two of the others
        assert notes[role]["address"] == "emulated"
    assert notes["load_cell"]["tare"].endswith(" N, mean of 2 s")
    assert notes["frames"]["current"] == "0.4 mA"
    assert "kΩ" in notes["frames"]["contacts"]


def test_a_column_of_which_no_instrument_has_anything_is_left_out(result):
    one = result.record.identity.instruments[0]
    there = replace(one, serial="12", firmware="", simulated=True, calibration_due=None, notes=())
    for instruments, columns in (
        ((there,), ("Role", "Driver", "Model", "Serial", "Notes")),
        (
            (there, replace(there, firmware="3", calibration_due="2027-03-31")),
            ("Role", "Driver", "Model", "Serial", "Firmware", "Calibration due", "Notes"),
        ),
        ((replace(there, simulated=False),), ("Role", "Driver", "Model", "Serial", "Calibration due")),
    ):
        record = replace(result.record, identity=replace(result.record.identity, instruments=instruments))
        table = next(Traceability().blocks(replace(result, record=record)))
        assert table.columns == columns
        assert all(len(row) == len(columns) for row in table.rows)


def test_the_software_that_speaks_to_instruments_is_named():
    found = dict(software_versions(PLUGINS))
    for name in ("cbsr-qa", "numpy", "pyserial", "pyvisa", "pyvisa-py"):
        assert found[name] == version(name)
