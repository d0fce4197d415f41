"""A head that is not round: declared in a station file, pressed in simulation, kept with runs and calibrations."""

import json
from dataclasses import replace
from importlib.resources import files

import pytest
from calibration_samples import assert_same, sample_calibration

from cbsr_qa.calibration.file.hdf5 import read_calibration, stamp, write_calibration
from cbsr_qa.config.loader import load_sensor_type, load_station
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.store.runs.codec import decode_indenter, encode_setting

ELL = [[-3.0, -3.0], [5.0, -3.0], [5.0, 0.0], [0.0, 0.0], [0.0, 5.0], [-3.0, 5.0]]


@pytest.fixture
def station_with(tmp_path):
    """Load the simulated station with another ``[indenter]`` table."""

    def load(table: str) -> Indenter:
        text = files("cbsr_qa._stations").joinpath("simulated.toml").read_text()
        assert "diameter_mm = 13.0" in text
        path = tmp_path / "simulated.toml"
        path.write_text(text.replace("diameter_mm = 13.0", table, 1))
        return load_station(path).value.indenter

    return load


def test_a_station_declares_an_outline(station_with):
    head = station_with(f"outline_mm = {ELL}")
    assert head.area_mm2 == pytest.approx(39.0)
    assert head.footprint_at(0.0, 0.0).outline_mm().tolist() == ELL
    assert station_with(f"outline_mm = {ELL[::-1]}") == head
    assert head.words() == "outline of 6 corners, 11.7 mm across"


def test_a_round_head_of_13_mm_is_what_a_station_has_unless_it_says_otherwise(station_with):
    assert station_with("") == Indenter(13.0) == station_with("diameter_mm = 13")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (f"diameter_mm = 13.0\noutline_mm = {ELL}", "one or the other"),
        ("outline_mm = [[0, 0], [4, 4], [4, 0], [0, 4]]", "sides 1 and 3 of the outline meet"),
        ("outline_mm = [[0, 0], [4, 4]]", "at least 3"),
        ("outline_mm = [[0, 0], [4, 4], [4]]", "outline_mm"),
    ],
    ids=["both", "crossing", "two corners", "no pair"],
)
def test_what_is_no_head_is_refused_with_its_line(station_with, table, said):
    with pytest.raises(ConfigError, match=said) as caught:
        station_with(table)
    assert "indenter" in str(caught.value)


def test_a_stored_run_keeps_the_outline():
    head = Indenter.with_outline([(x, y) for x, y in ELL])
    setting = json.loads(json.dumps(encode_setting(load_sensor_type("disc-100mm").value, head)))
    assert decode_indenter(setting) == head
    del setting["indenter"]["outline_mm"]  # as it was before heads had one
    assert decode_indenter(setting) == Indenter(head.diameter_mm)


def test_a_calibration_keeps_the_outline(tmp_path):
    calibration = replace(sample_calibration(), indenter=Indenter.with_outline([(x, y) for x, y in ELL]))
    write_calibration(tmp_path / "sensor.h5", calibration)
    assert_same(read_calibration(tmp_path / "sensor.h5"), stamp(calibration), "calibration")
