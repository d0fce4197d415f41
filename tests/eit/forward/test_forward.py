import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from benchmarks.reference_solutions import pin_transfer_impedance
from cbsr_qa.domain import NumericsError
from cbsr_qa.domain.sensor import DrivePattern, Mesh
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet, arc_transfer_impedance
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.testing import assert_expected_order

SIZES = (0.056, 0.04, 0.028)  # in this range every edge length scales with the size


@pytest.fixture(scope="module")
def model(pin_sensor, model_of) -> ForwardModel:
    return model_of(pin_sensor(), size_mm=5.0, contact=0.3)


def relative_error(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


# The current density is singular at an arc's ends, more so the smaller z: grading at the ends brings back most of the
# second order that a uniform mesh loses (1 at z = 0.001, 1.5 at z = 0.1).
@pytest.mark.rest
@pytest.mark.parametrize(
    ("contact", "order", "finest_error"), [(0.1, 1.9, 2e-3), (0.05, 1.9, 2e-3), (0.001, 1.8, 6e-3)]
)
def test_arcs_converge_to_the_exact_solution(arc_sensor, model_of, contact, order, finest_error):
    sensor = arc_sensor()
    sheet = ConcentricSheet(1.0, 1.0)
    angles = sensor.electrodes.angles_rad()
    exact = arc_transfer_impedance(sheet, angles, 0.05, contact, modes=20, harmonics=50_000)
    errors = [
        relative_error(model_of(sensor, size_mm=size, contact=contact).transfer_impedance, exact) for size in SIZES
    ]
    assert_expected_order(errors, SIZES, order, 0.3)
    assert errors[-1] < finest_error


@pytest.mark.rest
@pytest.mark.parametrize("contact", [0.01, 0.5])
def test_pins_converge_to_the_exact_solution(pin_sensor, model_of, contact):
    sensor = pin_sensor()
    exact = pin_transfer_impedance(50.0, 1.0, sensor.electrodes, contact)
    sizes = (2.8, 2.0, 1.4)  # from where there are more edges round a pin than the least
    errors = [
        relative_error(model_of(sensor, size_mm=size, contact=contact).transfer_impedance, exact) for size in sizes
    ]
    assert_expected_order(errors, sizes, 2.0, 0.3)
    assert errors[-1] < 5e-3


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
