"""Certificates of reference standards in a station file."""

from dataclasses import replace

import pytest

from cbsr_qa.config.loader import load_material, load_sensor_type, load_station
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.standards import ReferenceStandard, name_unstated
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.station.limits import load_violations
from cbsr_qa.station.plan import Plan

_STATED = """
[standards.load_cell]
certificate = "K-2026-0711"
laboratory = "D-K-15000"
date = 2026-03-02
due = "2027-03-31"
uncertainty = 0.5
k = 2
unit = "%"
"""


@pytest.fixture
def read(tmp_path):
    shipped = load_station("simulated").document.text

    def read_station(standards, *changes):
        path, text = tmp_path / "mine.toml", shipped
        for given, instead in changes:
            assert given in text
            text = text.replace(given, instead)
        path.write_text(text + standards)
        return load_station(path).value

    return read_station


def test_a_certificate_is_read_as_it_is_stated(read):
    (standard,) = read(_STATED).standards
    assert standard == ReferenceStandard(
        "load_cell", "K-2026-0711", "D-K-15000", "2026-03-02", "2027-03-31", 0.5, 2.0, "%"
    )
    assert standard.standard_uncertainty == 0.0025


def test_a_station_without_certificates_states_none(read):
    assert read("").standards == ()


@pytest.mark.parametrize(
    ("given", "instead", "said"),
    [
        ("k = 2", "", "standards.load_cell.k is missing"),
        ('unit = "%"', "", "standards.load_cell.unit is missing"),
        ('unit = "%"', 'unit = "mm"', "standards.load_cell.unit is 'mm'"),
        ('unit = "%"', 'unit = "kg"', "standards.load_cell.unit is 'kg'"),
        ("uncertainty = 0.5", "uncertainty = 0", "standards.load_cell.uncertainty is 0"),
        ("uncertainty = 0.5", "uncertainty = -0.5", "standards.load_cell.uncertainty is -0.5"),
        ("uncertainty = 0.5", "uncertainty = nan", "standards.load_cell.uncertainty is not a finite number"),
        ("uncertainty = 0.5", "uncertainty = 99", "standards.load_cell.uncertainty is 99 %; allowed: at most 20 %"),
        ("uncertainty = 0.5", "uncertainty = 1e-300", "standards.load_cell.uncertainty is 1e-300 %, less than"),
        ("k = 2", "k = 2\ndrift_a_year = 50", "standards.load_cell.drift_a_year is 50 %; allowed: at most 20 %"),
        (
            "k = 2",
            "k = 2\nresolution_N = 1000",
            "standards.load_cell.resolution_N is 1000, of a range of 20 N; allowed",
        ),
        ('"%"', '"N"\nrange_N = [0.0, 2.0]', "standards.load_cell.uncertainty is 0.5 N, of a range of 2 N; allowed"),
        ("k = 2", "k = 2\nresolution_N = 0.5", "u = 0.05 N at most, and steps of 0.5 N alone are 0.144 N"),
        (
            "k = 2",
            "k = 2\nrange_N = [0.1, 1e9]\nresolution_N = 1000",
            "standards.load_cell.resolution_N is 1000, of a range of 20 N; allowed: at most 2",
        ),
        ("k = 2", "k = 0.5", "standards.load_cell.k is 0.5"),
        ('"K-2026-0711"', '""', "standards.load_cell.certificate is ''"),
        ('"2027-03-31"', '"2026-03-02"', "standards.load_cell.due 2026-03-02 is not after the date of calibration"),
        ('"2027-03-31"', '"soon"', "standards.load_cell.due is 'soon'; it must be a date like 2027-03-31"),
        ('due = "2027-03-31"', "", "standards.load_cell.due is missing; it must be a date like 2027-03-31"),
        ("[standards.load_cell]", "[standards.lood_cell]", "standards.lood_cell"),
    ],
)
def test_what_a_certificate_cannot_state_is_refused(read, given, instead, said):
    with pytest.raises(ConfigError) as caught:
        read(_STATED.replace(given, instead))
    assert said in caught.value.reason


@pytest.mark.parametrize(
    ("given", "instead", "key"),
    [
        ("k = 2", "k = 2\nrange_N = [20.0, 0.1]\nresolution_N = 0.001", "range_N is 20 to 0.1 N, no range"),
        ("uncertainty = 0.5", "uncertainty = 1e-300\nresolution_N = 0.01", "uncertainty is 1e-300 %, less than"),
    ],
)
def test_nothing_is_derived_from_a_value_that_is_wrong(read, given, instead, key):
    with pytest.raises(ConfigError) as caught:
        read(_STATED.replace(given, instead))
    assert caught.value.reason.count("standards.load_cell.") == 1
    assert key in caught.value.reason


@pytest.mark.parametrize(("uncertainty_mm", "is_refused"), [(12, True), (2.7, True), (2.5, False)])
def test_a_diameter_is_known_to_a_fifth(read, uncertainty_mm, is_refused):
    head = _STATED.replace("load_cell", "indenter").replace('"%"', '"mm"').replace("0.5", str(uncertainty_mm))
    if not is_refused:
        assert read(head).standards
        return
    with pytest.raises(ConfigError, match=r"uncertainty is .* mm, of a head of 13 mm; allowed: at most 2\.6"):
        read(head)


def test_a_diameter_is_refused_for_a_head_that_is_not_round(read):
    head = _STATED.replace("load_cell", "indenter").replace('"%"', '"mm"')
    assert read(head).standards[0].unit == "mm"
    square = "outline_mm = [[-5, -5], [5, -5], [5, 5], [-5, 5]]"
    with pytest.raises(ConfigError, match=r'standards\.indenter\.unit is "mm", of a diameter'):
        read(head, ("diameter_mm = 13.0", square))


_STAGE = """
[standards.stage]
certificate = "S-7"
laboratory = "D-K-15002"
date = 2026-03-02
due = 2027-03-31
uncertainty = 0.02
k = 2
unit = "mm"
range_mm = [0.0, 250.0]
resolution_mm = 0.01
drift_a_year = 0.03
"""
_THERMOMETER = """
[standards.thermometer]
certificate = "T-3"
laboratory = "D-K-15003"
date = 2026-03-02
due = 2027-03-31
uncertainty = 0.2
k = 2
unit = "°C"
range_C = [10.0, 40.0]
"""
_SOURCE_METER = """
[standards.source_meter]
certificate = "Q-9"
laboratory = "D-K-15004"
date = 2026-03-02
due = 2027-03-31
uncertainty = 0.05
k = 2
unit = "%"
range_mA = [0.1, 1.0]
"""


_WITH_THERMOMETER = ('"force"]', '"force", "temperature"]')


def test_what_places_and_reads_is_stated_beside_the_load_cell(read):
    standards = read(_STATED + _STAGE + _THERMOMETER + _SOURCE_METER, _WITH_THERMOMETER).standards
    assert [standard.role for standard in standards] == ["load_cell", "stage", "thermometer", "source_meter"]
    stage, source_meter = standards[1], standards[3]
    assert (stage.range_low, stage.range_high, stage.resolution, stage.drift_a_year) == (0.0, 250.0, 0.01, 0.03)
    assert stage.all_words() == (
        "U = 0.02 mm (k = 2), certificate S-7 of D-K-15002, due 2027-03-31, range 0 to 250 mm, resolution 0.01 mm,"
        " drift at most 0.03 mm a year"
    )
    assert "range not stated, resolution not stated, drift not stated" in standards[0].all_words()
    assert "range 10 to 40 °C, resolution not stated" in standards[2].all_words()
    assert "resolution" not in source_meter.all_words()
    assert source_meter.standard_uncertainty == 0.00025
    assert source_meter.drift_uncertainty(1.0) is None
    assert name_unstated(standards) == ("indenter",)


def test_the_drift_of_a_standard_is_a_rectangle_that_grows_from_its_date():
    standard = ReferenceStandard("load_cell", "K", "L", "2026-01-01", "2027-01-01", 0.5, 2.0, "%", drift_a_year=0.3)
    assert standard.drift_uncertainty(2.0) == pytest.approx(0.006 / 3**0.5)
    assert standard.drift_uncertainty(-1.0) == 0


@pytest.mark.parametrize(
    ("table", "given", "instead", "said"),
    [
        (_STAGE, "k = 2", "", "standards.stage.k is missing"),
        (_STAGE, 'unit = "mm"', "", "standards.stage.unit is missing"),
        (_STAGE, 'unit = "mm"', 'unit = "%"', "standards.stage.unit is '%'"),
        (_STAGE, "0.02", "-0.02", "standards.stage.uncertainty is -0.02"),
        (_STAGE, "0.02", "1e-9", "standards.stage.uncertainty is 1e-09 mm, less than national institutes reach"),
        (_STAGE, "0.02", "60", "standards.stage.uncertainty is 60 mm, of a range of 82 mm; allowed: at most 16.4 mm"),
        (_STAGE, "0.02", "0.001", "standards.stage.uncertainty means u = 0.0005 mm at most, and steps of 0.01 mm"),
        (_STAGE, "= 0.03", "= 80.0", "standards.stage.drift_a_year is 80 mm, of a range of 82"),
        (
            _THERMOMETER,
            "k = 2",
            "k = 2\nresolution_C = 5.0",
            "standards.thermometer.resolution_C is 5, of a range of 30",
        ),
        (_STAGE, "0.03", "-0.03", "standards.stage.drift_a_year is -0.03"),
        (_STAGE, "resolution_mm = 0.01", "resolution_mm = 0", "standards.stage.resolution_mm is 0"),
        (_STAGE, "[0.0, 250.0]", "[250.0, 0.0]", "standards.stage.range_mm is 250 to 0 mm, no range"),
        (_STAGE, "[0.0, 250.0]", "[250.0]", "standards.stage.range_mm"),
        (_STAGE, "range_mm", "range_N", "standards.stage.range_N"),
        (_STAGE, "date = 2026-03-02", "date = 1826-03-02", "standards.stage.due is 2027-03-31, of a calibration on"),
        (_THERMOMETER, "°C", "K", "standards.thermometer.unit is 'K'"),
        (_THERMOMETER, "due = 2027-03-31", "", "standards.thermometer.due is missing"),
        (_SOURCE_METER, '"Q-9"', '""', "standards.source_meter.certificate is ''"),
    ],
)
def test_what_another_certificate_cannot_state_is_refused(read, table, given, instead, said):
    with pytest.raises(ConfigError) as caught:
        read(table.replace(given, instead))
    assert said in caught.value.reason


def test_a_thermometer_that_measures_nothing_is_refused(read):
    with pytest.raises(
        ConfigError, match=r'standards\.thermometer is stated, and no instrument provides "temperature"'
    ):
        read(_THERMOMETER)
    assert read(_THERMOMETER, _WITH_THERMOMETER).standards


@pytest.mark.parametrize(("current_mA", "is_covered"), [("0.4", True), ("1", True), ("0.05", False), ("2", False)])
def test_a_source_meter_covers_the_current_that_the_station_states(tmp_path, current_mA, is_covered):
    shipped = load_station("bench-emulated").document.text
    path = tmp_path / "mine.toml"
    path.write_text(shipped.replace("\ncurrent_mA = 0.4", f"\ncurrent_mA = {current_mA}") + _SOURCE_METER)
    if is_covered:
        assert load_station(path).value.standards
        return
    with pytest.raises(ConfigError) as caught:
        load_station(path)
    said = f"standards.source_meter.range_mA is 0.1 to 1 mA, and instruments.{{}}.current_mA {current_mA} mA"
    before, after = said.split("{}")
    assert before in caught.value.reason
    assert after in caught.value.reason


def test_a_thermometer_covers_the_temperatures_that_the_station_allows(read):
    allowed = ("duration_h = ", "temperature_C = [5.0, 30.0]\nduration_h = ")
    with pytest.raises(
        ConfigError, match=r"standards\.thermometer\.range_C is 10 to 40 °C, and safety\.temperature_C"
    ):
        read(_THERMOMETER, _WITH_THERMOMETER, allowed)
    assert read(_THERMOMETER, _WITH_THERMOMETER, (allowed[0], allowed[1].replace("5.0", "15.0"))).standards


@pytest.mark.parametrize(
    ("standard", "said"),
    [
        (_STATED + "range_N = [10.0, 50.0]\n", "N expected once relaxed; certificate K-2026-0711 covers 10 to 50 N"),
        (
            _STAGE.replace("250.0", "20.0"),
            "certificate S-7 covers 0 to 20 mm (standards.stage.range_mm of the station",
        ),
    ],
)
def test_loads_beyond_a_certificate_are_found_before_anything_moves(read, standard, said):
    station = read(standard)
    material, sensor_type = load_material("cbsr-8wt").value, load_sensor_type("disc-100mm").value
    plan = Plan((), sensor_type, material, station.indenter, station.motion, station.safety, 1, station.standards)
    load = Load("L1", 30.0, 0.0, 0.1, 0)
    (violation,) = [one for one in load_violations(load, plan) if one.rule == "standard"]
    assert said in violation.what
    assert not [one for one in load_violations(load, replace(plan, standards=())) if one.rule == "standard"]
