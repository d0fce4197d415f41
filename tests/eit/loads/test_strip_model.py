"""The strip between two pins, against what is known of it without finite elements."""

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st
from strip_samples import models
from tiers import rest_but

from cbsr_qa.config.loader import load_scene, load_sensor_type, load_station
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.outlines import Polygon
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, PlacedElectrodes
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import polygon_sensor
from cbsr_qa.eit.loads.bodies import StripModel, check_strip
from cbsr_qa.simulate.sheet import SimulatedSheet

PAIR = DrivePattern(2, ((0, 1),), ((0, 1),))
CHANGES = np.array([-0.5, -0.1, 0.03, 0.18, 1.0])


def bar(contact_mm):
    """A bar of 40 × 20 mm between contacts over its whole ends: a chain of resistors, exactly."""
    corners = ((-20.0, -10.0), (20.0, -10.0), (20.0, 10.0), (-20.0, 10.0))
    # A strip a little shorter than an end is one over all of it once it is meshed.
    ends = PlacedElectrodes(ElectrodeKind.ARC, ((-20.0, 0.0), (20.0, 0.0)), 19.98)
    sensor = polygon_sensor("bar", Polygon(corners), 4.0, ends, PAIR)
    head = Indenter.with_outline([(-5, -10), (5, -10), (5, 10), (-5, 10)])
    return StripModel(sensor, head, contact_mm)


@pytest.mark.parametrize("contact_mm", rest_but({2.0}, [0.2, 2.0]))
def test_a_bar_between_whole_ends_is_a_chain_of_resistors(contact_mm):
    model = bar(contact_mm)
    contacts = 2 * contact_mm / 20.0
    assert model.contact_squares == pytest.approx(contacts, rel=1e-9)
    assert model.squares == pytest.approx(2.0 + contacts, rel=1e-9)
    # A quarter of its length is pressed: half a square.
    expected = model.squares / (model.squares - 0.5 + 0.5 / (1 + CHANGES)) - 1
    np.testing.assert_allclose(model.apparent(CHANGES), expected, rtol=2e-3)
    assert model.share == pytest.approx(0.5 / model.squares, rel=1e-3)
    assert model.pressed_mm2 == pytest.approx(200.0, rel=1e-9)


def test_a_finer_mesh_of_another_maker_agrees():
    """The simulated strip, with a mesh of its own, is changed under the head by the same."""
    station, sensor_type = load_station("simulated-strip").value, load_sensor_type("strip-40x20mm").value
    design = SheetDesign.make_uniform(sensor_type, station.indenter, 0.2)
    size_mm = load_scene("strip").value.sheet_mesh_size_mm
    sheet = SimulatedSheet(design, size_mm=size_mm, interelectrode_resistance_ohm=18_100.0)
    read = np.array([sheet.voltages({(0.0, 0.0): float(change)})[0, 0] for change in CHANGES])
    np.testing.assert_allclose(models()[0].apparent(CHANGES), sheet.unloaded[0, 0] / read - 1, rtol=1e-3)
    assert models()[0].squares == pytest.approx(sheet.unloaded[0, 0] * sheet.conductance_S, rel=1e-3)


@drawn(50)
@given(st.floats(-0.9, 10.0))
def test_there_and_back_is_where_it_began(change):
    model = models()[0]
    there = model.apparent(np.array([change]))
    assert model.local(there)[0] == pytest.approx(change, rel=1e-4, abs=1e-7)
    assert abs(there[0]) <= abs(change) + 1e-12


def test_contacts_in_series_hide_more():
    model, other = models()
    assert other.contact_squares == pytest.approx(1.5 * model.contact_squares, rel=0.01)
    # In series with the strip they add to it, and leave the current in it as it was.
    assert other.squares - other.contact_squares == pytest.approx(model.squares - model.contact_squares, rel=2e-3)
    assert other.share * other.squares == pytest.approx(model.share * model.squares, rel=2e-3)


def test_more_than_the_strip_can_do_is_refused():
    with pytest.raises(NumericsError, match="the material under the head can change it by") as refused:
        models()[0].local(np.array([0.01, 2.0]))
    assert "loose pin" in refused.value.remedy


def test_what_is_no_strip_is_refused():
    with pytest.raises(NumericsError, match="'disc-100mm' is not a strip"):
        check_strip(load_sensor_type("disc-100mm").value)
    with pytest.raises(NumericsError, match="does not touch the strip"):
        StripModel(load_sensor_type("strip-40x20mm").value, Indenter(13.0), 0.2, place_mm=(60.0, 0.0))
