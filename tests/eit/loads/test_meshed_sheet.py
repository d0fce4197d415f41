"""Fields read from a mesh's edge: against exact ones, and against loads put into meshes of discs and patches."""

from functools import lru_cache

import numpy as np
import pytest
from tiers import rest_but

from benchmarks.reference_solutions import fitted_mesh
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.eit.estimate.load_estimate import LoadEstimator
from cbsr_qa.eit.estimate.readings import load_model, merge_reciprocal
from cbsr_qa.eit.forward.model import ForwardModel, point_model
from cbsr_qa.eit.inverse.problem import NOMINAL_CONTACT_MM
from cbsr_qa.eit.loads.meshed_sheet import MeshedSheet
from cbsr_qa.eit.loads.pinned_disc import PinnedDisc
from cbsr_qa.eit.loads.round_load import RoundLoadModel, RoundLoads
from cbsr_qa.eit.mesh.sheet import sheet_mesh

PATCH = load_sensor_type("patch-120x80mm").value


def meshed(sensor, *, size_mm: float, order: int = 2, contact: float = NOMINAL_CONTACT_MM) -> ForwardModel:
    mesh = sheet_mesh(sensor, size_mm=size_mm, order=order)
    contacts = np.full(sensor.electrodes.count, contact)
    return ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), contacts, order=order)


@lru_cache(maxsize=2)
def base_mesh(sensor, size_mm):
    return sheet_mesh(sensor, size_mm=size_mm, order=2)


def meshed_change(sensor, size_mm, place, radius, contrast):
    mesh, inside = fitted_mesh(base_mesh(sensor, size_mm), place, radius)
    contacts = np.full(sensor.electrodes.count, NOMINAL_CONTACT_MM)
    plain = ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), contacts, order=2)
    return plain.with_values(conductance=1 + contrast * inside).voltages() - plain.voltages()


def one(place, radius, contrast) -> RoundLoads:
    return RoundLoads.from_contrast(np.array([place]), np.array([radius]), np.array([contrast]))


@pytest.mark.parametrize(("order", "allowed"), rest_but({2}, [(1, 3e-3), (2, 1e-5)]))
def test_a_disc_with_pins_has_its_exact_fields(pin_sensor, order, allowed):
    sensor = pin_sensor()
    exact = PinnedDisc(50.0, sensor.electrodes, NOMINAL_CONTACT_MM)
    read = MeshedSheet(meshed(sensor, size_mm=6.0 / (3 - order), order=order), 50.0)
    used = sensor.pattern.usable()
    for place in ((0.0, 0.0), (20.0, -7.0), (30.0, 0.0), (36.0, 3.0)):
        load = one(place, 6.5, 0.5)
        found, expected = (RoundLoadModel(sheet, sensor.pattern).readings(load) for sheet in (read, exact))
        assert np.linalg.norm((found.change - expected.change)[0][used]) < allowed * np.linalg.norm(
            expected.change[0][used]
        )
        for own, other in zip(found.slope[0], expected.slope[0], strict=True):
            assert np.linalg.norm((own - other)[used]) < 5 * allowed * np.linalg.norm(other[used])


def test_finer_meshes_converge_far_faster_than_their_elements(pin_sensor):
    sensor = pin_sensor()
    exact = PinnedDisc(50.0, sensor.electrodes, NOMINAL_CONTACT_MM)
    places, reach, free = np.array([[24.0, 11.0]]), np.array([6.5]), np.eye(16) - 1 / 16
    expected = exact.expansion(places, reach, 5)
    errors = []
    for size in (12.0, 6.0):
        found = MeshedSheet(meshed(sensor, size_mm=size), 50.0).expansion(places, reach, 5)
        errors.append(
            (
                np.abs((found.fields - expected.fields) @ free).max() / np.abs(expected.fields @ free).max(),
                np.abs(found.response - expected.response).max() / np.abs(expected.response).max(),
            )
        )
    assert (np.array(errors[1]) < np.array(errors[0]) / 2**2.5).all()
    assert max(errors[1]) < 1e-5


@pytest.mark.rest
def test_what_is_sent_back_is_reciprocal(arc_sensor):
    response = (
        MeshedSheet(meshed(arc_sensor(radius_mm=50.0), size_mm=6.0), 50.0)
        .expansion(np.array([[10.0, 20.0], [-5.0, 0.0]]), np.array([5.0, 8.0]), 6)
        .response
    )
    paired = response * np.tile(np.arange(1, 7), 2)[:, None]
    assert np.abs(paired - paired.swapaxes(1, 2)).max() < 1e-8 * np.abs(paired).max()


def test_fields_alone_are_those_of_the_expansion(arc_sensor):
    for sheet in (
        MeshedSheet(meshed(arc_sensor(radius_mm=50.0), size_mm=8.0), 50.0),
        load_model(load_sensor_type("disc-100mm").value).surroundings,
    ):
        places, reach = np.array([[10.0, 20.0], [-5.0, 0.0]]), np.array([5.0, 8.0])
        assert np.array_equal(sheet.fields(places, reach, 5), sheet.expansion(places, reach, 5).fields)


@pytest.mark.parametrize("place", [pytest.param((0.0, 0.0), marks=pytest.mark.rest), (-40.0, -18.0)])
def test_a_patch_with_corners_under_a_load_agrees_with_the_load_in_the_mesh(place):
    expected = meshed_change(PATCH, 4.5, place, 6.5, 0.5)
    found = load_model(PATCH).readings(one(place, 6.5, 0.5)).change[0]
    used = PATCH.pattern.usable()
    assert np.linalg.norm((found - expected)[used]) < 1e-3 * np.linalg.norm(expected[used])


@pytest.mark.rest
def test_a_disc_with_strips_under_a_load_agrees_with_the_load_in_the_mesh(arc_sensor):
    sensor = arc_sensor(radius_mm=50.0)
    expected = meshed_change(sensor, 5.0, (20.0, 12.0), 6.5, -0.4)
    found = load_model(sensor).readings(one((20.0, 12.0), 6.5, -0.4)).change[0]
    used = sensor.pattern.usable()
    assert np.linalg.norm((found - expected)[used]) < 2e-3 * np.linalg.norm(expected[used])


@pytest.mark.rest
def test_loads_on_a_patch_are_found():
    model = load_model(PATCH)
    used = PATCH.pattern.usable()
    readings = merge_reciprocal(PATCH.pattern, used, (1e-3 * model.solve_unloaded()) ** 2)
    estimator = LoadEstimator(model, readings, expected_radius_mm=6.5, known=False)
    for place in ((-40.0, -18.0), (50.0, 10.0)):
        found = estimator.estimate(meshed_change(PATCH, 4.5, place, 6.5, 0.3)[used][None])[0]
        assert np.hypot(found.place_mm[0] - place[0], found.place_mm[1] - place[1]) < 0.1 * found.place_stderr_mm
        assert found.radius_mm.value == pytest.approx(6.5, abs=0.2 * found.radius_mm.stderr)


def test_clearance_is_negative_beside_the_sheet_and_in_a_pin(pin_sensor):
    sheet = MeshedSheet(meshed(pin_sensor(), size_mm=8.0), 50.0)
    inside, beside, in_pin = sheet.clearance_mm(np.array([[40.0, 0.0], [60.0, 0.0], [48.0, 0.0]]))
    assert inside == pytest.approx(8 - 0.325, abs=0.01)
    assert beside == pytest.approx(-10, abs=0.1)
    assert in_pin < 0
    assert sheet.extent_mm == pytest.approx((-50, 50, -50, 50), abs=0.1)


def test_uneven_sheets_and_point_electrodes_are_refused(pin_sensor):
    model = meshed(pin_sensor(), size_mm=8.0)
    with pytest.raises(NumericsError, match="unit conductance"):
        MeshedSheet(
            model.with_values(conductance=model.conductance * np.linspace(1, 2, len(model.conductance))), 50.0
        )
    points = point_model(model.mesh, np.arange(16), pin_sensor().pattern, model.conductance)
    with pytest.raises(NumericsError, match="point electrodes"):
        MeshedSheet(points, 50.0)
