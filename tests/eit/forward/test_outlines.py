"""Voltages on sheets that are no discs, against exact solutions."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.reference_solutions import pin_transfer_impedance
from cbsr_qa.domain.geometry.outlines import Polygon
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, PlacedElectrodes
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import polygon_sensor
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.mesh.sheet import sheet_mesh

OPEN = 1e9  # contact impedance of an electrode that is not there


def strip_model(outline, places, width, size_mm, contacts, order=1, conductance=0.3):
    """Two strips in use; the third closes the layout and is not there."""
    electrodes = PlacedElectrodes(ElectrodeKind.ARC, places, width)
    sensor = polygon_sensor("strips", outline, 1.0, electrodes, DrivePattern(3, ((0, 1),), ((0, 1),)))
    mesh = sheet_mesh(sensor, size_mm=size_mm, order=order)
    gamma = np.full(len(mesh.elements), conductance)
    return ForwardModel(mesh, sensor.pattern, gamma, np.array([contacts, contacts, OPEN]), order=order)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_rectangle_between_whole_ends_has_its_resistance_of_length_over_width(order, angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    corners, ends = ([(0, 0), (60, 0), (60, 20), (0, 20)], [(0, 10), (60, 10), (30, 0)])
    outline = Polygon(tuple(map(tuple, (np.array(corners) @ turn.T).tolist())))
    places = tuple(map(tuple, (np.array(ends) @ turn.T).tolist()))
    model = strip_model(outline, places, 20.0, 3.0, 5.0, order)
    assert model.voltages()[0, 0] == pytest.approx(60 / (0.3 * 20) + 2 * 5.0 / 20, rel=3e-8)


def bend_error(size_mm, order):
    """Of a right-angled bend: its corner counts as 1 − (2/π) ln 2 squares (conformal map; Hall 1967)."""
    width, arm = 10.0, 60.0
    outline = Polygon(((0, 0), (70, 0), (70, 10), (10, 10), (10, 70), (0, 70)))
    places = ((width + arm, width / 2), (width / 2, width + arm), (0.0, 30.0))
    model = strip_model(outline, places, width, size_mm, 0.1, order, conductance=1.0)
    exact = 2 * arm / width + 1 - 2 / np.pi * np.log(2)
    return (model.voltages()[0, 0] - 2 * 0.1 / width) / exact - 1


@pytest.mark.rest
def test_a_bend_converges_to_the_conformal_maps_resistance():
    errors = np.abs([bend_error(size, 1) for size in (3.0, 1.5, 0.75)])
    assert (np.log2(errors[:-1] / errors[1:]) > 1.1).all()  # 4/3 where nothing is refined at the corner
    assert errors[-1] < 3e-4


def test_elements_of_second_order_are_graded_at_the_bend():
    errors = np.abs([bend_error(size, 2) for size in (3.0, 1.5)])
    assert errors[0] < 2e-5
    assert np.log2(errors[0] / errors[1]) > 2


def test_pins_placed_one_by_one_on_a_disc_have_the_exact_voltages(pin_sensor):
    sensor = pin_sensor()
    places = tuple(map(tuple, sensor.electrodes.positions_mm().tolist()))
    single = replace(sensor, electrodes=PlacedElectrodes(ElectrodeKind.PIN, places, 0.65))
    exact = pin_transfer_impedance(50.0, 1.0, sensor.electrodes, 0.2)
    mesh = sheet_mesh(single, size_mm=6.0, order=2)
    model = ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), np.full(16, 0.2), order=2)
    assert np.linalg.norm(model.transfer_impedance - exact) < 1e-3 * np.linalg.norm(exact)
    assert len(mesh.arcs) == 4 + 16  # the disc's edge in quarters, and every pin
