"""Elements of first and second order against exact solutions, and what makes no model; laws: test_reading_laws.py."""

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st
from tiers import rest_but

from benchmarks.reference_solutions import pin_transfer_impedance, point_transfer_impedance
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet, arc_transfer_impedance
from cbsr_qa.eit.forward.coverage import cover
from cbsr_qa.eit.forward.model import ForwardModel, point_model
from cbsr_qa.eit.mesh.sheet import sheet_mesh
from cbsr_qa.testing.numerics import assert_expected_order

ANGLES = 2 * np.pi * np.arange(16) / 16
EVEN = ConcentricSheet(1.0, 1.0)


def relative_error(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


# --- first order ---


# The current density is singular at an arc's ends, more so the smaller z: grading at the ends brings back most of the
# second order that a uniform mesh loses (1 at z = 0.001, 1.5 at z = 0.1).
@pytest.mark.rest
@pytest.mark.parametrize(
    ("contact", "order", "finest_error"), [(0.1, 1.9, 2e-3), (0.05, 1.9, 2e-3), (0.001, 1.8, 6e-3)]
)
def test_arcs_converge_to_the_exact_solution_with_the_second_order(
    arc_sensor, model_of, contact, order, finest_error
):
    sizes = (0.056, 0.04, 0.028)  # in this range every edge length scales with the size
    exact = arc_transfer_impedance(EVEN, ANGLES, 0.05, contact, modes=20, harmonics=50_000)
    models = [model_of(arc_sensor(), size_mm=size, contact=contact) for size in sizes]
    errors = [relative_error(model.transfer_impedance, exact) for model in models]
    assert_expected_order(errors, sizes, order, 0.3)
    assert errors[-1] < finest_error


@pytest.mark.rest
@pytest.mark.parametrize("contact", [0.01, 0.5])
def test_pins_converge_to_the_exact_solution_with_the_second_order(pin_sensor, model_of, contact):
    sensor = pin_sensor()
    exact = pin_transfer_impedance(50.0, 1.0, sensor.electrodes, contact)
    sizes = (2.8, 2.0, 1.4)  # from where there are more edges round a pin than the least
    errors = [
        relative_error(model_of(sensor, size_mm=size, contact=contact).transfer_impedance, exact) for size in sizes
    ]
    assert_expected_order(errors, sizes, 2.0, 0.3)
    assert errors[-1] < 5e-3


# --- second order ---

SIZES = (0.2, 0.135, 0.09)  # of the radius


def model_on(sensor, size: float, contact: float = 0.05) -> ForwardModel:
    mesh = sheet_mesh(sensor, size_mm=size * sensor.radius_mm, order=2)
    count = sensor.electrodes.count
    return ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), np.full(count, contact), order=2)


@pytest.fixture(scope="module")
def arcs(arc_sensor) -> list[ForwardModel]:
    return [model_on(arc_sensor(), size) for size in SIZES]


def errors_of(models: list[ForwardModel], exact: np.ndarray) -> tuple[list[float], list[float]]:
    """Of the readings that touch no driven electrode, and of all."""
    usable = models[0].pattern.usable()
    pairs = [(model.voltages(), model.readings(exact)) for model in models]
    return [relative_error(f[usable], e[usable]) for f, e in pairs], [relative_error(f, e) for f, e in pairs]


# Elements this coarse do not yet reach the fourth order, which the grading keeps although the current density is
# singular at an arc's ends; a uniform mesh would show 1.1 (z = 0.001) to 1.9 (z = 0.1).
@pytest.mark.parametrize(("contact", "order"), rest_but({0.1, 0.001}, [(0.1, 3.3), (0.05, 3.35), (0.001, 3.75)]))
def test_arcs_converge_to_the_exact_solution_with_nearly_the_fourth_order(arcs, contact, order):
    exact = arc_transfer_impedance(EVEN, ANGLES, 0.05, contact, modes=30, harmonics=20_000)
    models = [model.with_values(contact_impedance=np.full(16, contact)) for model in arcs]
    used, every = errors_of(models, exact)
    assert_expected_order(every, SIZES, order, 0.25)
    assert_expected_order(used, SIZES, 3.7, 0.7)
    assert used[-1] < 1e-5


@pytest.mark.rest
def test_no_contact_impedance_costs_an_order(arcs):
    """With z → 0 the current density goes as r^(−1/2) at the ends, and the mesh is not graded for that."""
    exact = arc_transfer_impedance(EVEN, ANGLES, 0.05, 1e-5, modes=40, harmonics=40_000)
    used, every = errors_of([model.with_values(contact_impedance=np.full(16, 1e-5)) for model in arcs], exact)
    assert_expected_order(every, SIZES, 2.65, 0.3)
    assert used[-1] < 1e-4


@pytest.mark.rest
@pytest.mark.parametrize("contact", [0.01, 0.5])
def test_pins_converge_to_the_exact_solution_with_nearly_the_fourth_order(pin_sensor, contact):
    sensor = pin_sensor()
    exact = pin_transfer_impedance(50.0, 1.0, sensor.electrodes, contact)
    used, every = errors_of([model_on(sensor, size, contact) for size in SIZES], exact)
    assert_expected_order(used, SIZES, 3.9, 0.9)
    assert used[-1] < 1e-5
    assert every[-1] < 5e-4


def test_points_agree_with_the_exact_solution(arc_sensor):
    sensor = arc_sensor()
    usable = sensor.pattern.usable()
    mesh = sheet_mesh(sensor, size_mm=0.12)
    nodes = np.array([np.bincount(edges.ravel()).argmax() for edges in mesh.electrode_edges])
    angles = np.arctan2(mesh.nodes_mm[nodes, 1], mesh.nodes_mm[nodes, 0])
    plain = point_model(mesh, nodes, sensor.pattern, np.ones(len(mesh.elements)), order=2)
    load = cover(plain.elements, RoundFootprint(0.0, 0.0, 0.6))
    pressed = plain.with_change_on(load.elements, load.change(plain.conductance, 3.0))
    for model, inclusion, allowed in ((plain, 0.0, 1e-4), (pressed, 0.6, 2e-3)):
        exact = point_transfer_impedance(ConcentricSheet(1.0, 1.0, inclusion, 4.0), angles)
        assert relative_error(model.voltages()[usable], model.readings(exact)[usable]) < allowed


def test_an_inclusion_that_the_mesh_does_not_follow(arcs):
    usable = arcs[0].pattern.usable()
    for radius in (0.44, 0.5, 0.56):
        exact = arc_transfer_impedance(
            ConcentricSheet(1.0, 1.0, radius, 3.0), ANGLES, 0.05, 0.05, modes=12, harmonics=20_000
        )
        for model, allowed in zip(arcs, (1.5e-3, 1e-3, 6e-4), strict=True):
            load = cover(model.elements, RoundFootprint(0.0, 0.0, radius))
            pressed = model.with_change_on(load.elements, load.change(model.conductance, 2.0))
            scaled = model.with_change_on(load.elements, 2.0 * load.share)
            expected = model.readings(exact)[usable]
            error = relative_error(pressed.voltages()[usable], expected)
            assert error < allowed
            assert error < relative_error(scaled.voltages()[usable], expected)


def test_driving_point_resistances_rise_with_the_order(pin_sensor):
    """They are a maximum over all functions (Dirichlet's principle), and the second order has those of the first."""
    mesh = sheet_mesh(pin_sensor(), size_mm=8.0)
    straight = Mesh(mesh.nodes_mm, mesh.elements, mesh.electrode_edges)
    one, two = (
        ForwardModel(straight, pin_sensor().pattern, np.ones(len(mesh.elements)), np.full(16, 0.3), order=order)
        for order in (1, 2)
    )
    assert (np.diag(two.voltages()) > np.diag(one.voltages())).all()


def test_a_turned_and_stretched_sheet_conducts_by_direction(arc_sensor):
    """Stretching x by a turns conductance 1 into diag(a, 1/a), and leaves every voltage."""
    mesh = sheet_mesh(arc_sensor(), size_mm=0.2)
    pattern, contact = arc_sensor().pattern, np.full(16, 1e-6)
    straight = Mesh(mesh.nodes_mm, mesh.elements, mesh.electrode_edges)
    wide = Mesh(mesh.nodes_mm * [2.0, 1.0], mesh.elements, mesh.electrode_edges)
    one = ForwardModel(straight, pattern, np.ones(len(mesh.elements)), contact, order=2)
    matrices = np.tile(np.diag([2.0, 0.5]), (len(mesh.elements), 3, 1, 1))
    other = ForwardModel(wide, pattern, matrices, contact, order=2)
    usable = pattern.usable()
    assert np.allclose(one.voltages()[usable], other.voltages()[usable], rtol=1e-3)


# --- any order ---


@pytest.fixture(scope="module")
def model(pin_sensor, model_of) -> ForwardModel:
    return model_of(pin_sensor(), size_mm=5.0, contact=0.3)


@given(factor=st.floats(1e-3, 1e3))
@drawn(15)
def test_a_sheet_is_as_good_enlarged(model, factor):
    mesh = Mesh(factor * model.mesh.nodes_mm, model.mesh.elements, model.mesh.electrode_edges)
    enlarged = ForwardModel(mesh, model.pattern, model.conductance, factor * model.contact_impedance)
    assert np.allclose(enlarged.voltages(), model.voltages(), rtol=1e-9, atol=0)


def test_turning_by_one_electrode_changes_nothing(model, pin_sensor):
    voltages = model.voltages()
    usable = model.pattern.usable()
    for steps in (1, 5, 8):
        turned = np.roll(voltages, (steps, steps), axis=(0, 1))
        assert relative_error(turned[usable], voltages[usable]) < 5e-3


def test_any_pattern_is_a_combination_of_electrode_potentials(model):
    opposite = DrivePattern(16, tuple((k, k + 8) for k in range(8)), ((0, 5), (3, 2), (15, 1)))
    other = ForwardModel(model.mesh, opposite, model.conductance, model.contact_impedance)
    adjacent = model.voltages()
    chained = adjacent[0:8, 0:5].sum()  # 0→8 driven, 0→5 measured, as sums of neighbours
    assert other.voltages().shape == (8, 3)
    assert other.voltages()[0, 0] == pytest.approx(chained, rel=1e-10)


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf])
def test_impossible_values_are_refused_by_name(model, wrong):
    conductance = model.conductance.copy()
    conductance[3] = wrong
    with pytest.raises(NumericsError, match=r"conductance 3 is .* positive finite"):
        ForwardModel(model.mesh, model.pattern, conductance, model.contact_impedance)
    contact = model.contact_impedance.copy()
    contact[7] = wrong
    with pytest.raises(NumericsError, match=r"contact impedance 7 is .* positive finite"):
        ForwardModel(model.mesh, model.pattern, model.conductance, contact)


def test_a_mesh_in_pieces_is_refused(model):
    count = len(model.mesh.nodes_mm)
    nodes = np.vstack([model.mesh.nodes_mm, [[200, 0], [201, 0], [200, 1]]])
    elements = np.vstack([model.mesh.elements, [[count, count + 1, count + 2]]])
    mesh = Mesh(nodes, elements, model.mesh.electrode_edges)
    with pytest.raises(NumericsError, match="2 pieces"):
        ForwardModel(mesh, model.pattern, np.ones(len(elements)), model.contact_impedance)


@pytest.fixture(scope="module")
def uneven(pin_sensor) -> ForwardModel:
    """Uneven, so that symmetry hides no mistakes."""
    plain = model_on(pin_sensor(count=8), 0.2)
    random = np.random.default_rng(5)
    conductance = np.exp(random.normal(0, 0.5, len(plain.mesh.elements)))
    return plain.with_values(conductance=conductance, contact_impedance=random.uniform(0.1, 1, 8))


@pytest.mark.parametrize(
    "wrong",
    [
        np.diag([1.0, 0.0]),
        np.diag([1.0, -1.0]),
        np.array([[1.0, 2.0], [2.0, 1.0]]),
        np.array([[1.0, 0.1], [0.2, 1.0]]),
    ],
)
def test_impossible_directional_conductances_are_refused(uneven, wrong):
    conductance = np.tile(np.eye(2), (len(uneven.mesh.elements), 3, 1, 1))
    assert uneven.with_values(conductance=conductance).voltages().shape == uneven.pattern.shape
    conductance[7, 1] = wrong
    with pytest.raises(NumericsError, match=r"conductance 7 is .* in every direction"):
        uneven.with_values(conductance=conductance)
    with pytest.raises(NumericsError, match="conductance has shape"):
        uneven.with_values(conductance=conductance[:, :2])


def test_what_was_prepared_for_another_mesh_is_refused(uneven):
    mesh = Mesh(uneven.mesh.nodes_mm, uneven.mesh.elements, uneven.mesh.electrode_edges)
    with pytest.raises(NumericsError, match="another mesh"):
        ForwardModel(mesh, uneven.pattern, uneven.conductance, uneven.contact_impedance, prepared=uneven.prepared)


def test_changes_beside_the_mesh_are_refused(uneven):
    for element in (-1, len(uneven.mesh.elements)):
        with pytest.raises(NumericsError, match="not one of 0 to"):
            uneven.with_change_on(np.array([element]), np.array([0.1]))
