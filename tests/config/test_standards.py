"""Certificates of reference standards in a station file."""

import pytest

from cbsr_qa.config.loader import load_station
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.standards import ReferenceStandard

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

    def read_station(standards, change=("", "")):
        path = tmp_path / "mine.toml"
        path.write_text(shipped.replace(*change) + standards)
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
        ("uncertainty = 0.5", "uncertainty = 200", "standards.load_cell.uncertainty is 200 %, which states nothing"),
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


def test_a_diameter_is_refused_for_a_head_that_is_not_round(read):
    head = _STATED.replace("load_cell", "indenter").replace('"%"', '"mm"')
    assert read(head).standards[0].unit == "mm"
    square = "outline_mm = [[-5, -5], [5, -5], [5, 5], [-5, 5]]"
    with pytest.raises(ConfigError, match=r'standards\.indenter\.unit is "mm", of a diameter'):
        read(head, ("diameter_mm = 13.0", square))
