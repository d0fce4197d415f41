import numpy as np
import pytest
from disc_meshes import disc_mesh, square_mesh

from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.sensor.mesh import CircleArcs, Mesh
from cbsr_qa.eit.forward.elements import FiniteElements, edge_contacts, point_contacts
from cbsr_qa.eit.mesh.sheet import sheet_mesh
from cbsr_qa.testing.numerics import assert_expected_order

ORDERS = (1, 2)


def polynomials(order: int) -> list:
    linear = [lambda x, y: 1 + 0 * x, lambda x, y: x, lambda x, y: y]
    return linear if order == 1 else [*linear, lambda x, y: x * x, lambda x, y: x * y, lambda x, y: y * y]


def energy(elements: FiniteElements, one: np.ndarray, other: np.ndarray) -> float:
    cells = elements.cells
    return float(np.einsum("ei,eij,ej->", one[cells], elements.stiffness, other[cells]))


@pytest.mark.parametrize("order", ORDERS)
def test_energies_of_polynomials_are_exact(order):
    """On the unit square ∫ ∇(xᵃyᵇ)·∇(xᶜyᵈ) has a closed form."""
    elements = FiniteElements(square_mesh(3), order)
    x, y = elements.points_mm.T
    exact = np.diag([0.0, 1, 1, 4 / 3, 2 / 3, 4 / 3])
    exact[1, 3] = exact[3, 1] = exact[2, 5] = exact[5, 2] = 1.0  # ∫ 2x
    exact[1, 4] = exact[4, 1] = exact[2, 4] = exact[4, 2] = 0.5
    exact[3, 4] = exact[4, 3] = exact[4, 5] = exact[5, 4] = 0.5  # ∫ 2x·y
    found = [[energy(elements, p(x, y), q(x, y)) for q in polynomials(order)] for p in polynomials(order)]
    assert np.allclose(found, exact[: len(found), : len(found)], atol=1e-13)


@pytest.mark.parametrize("order", ORDERS)
def test_directional_stiffness_is_exact(order):
    elements = FiniteElements(square_mesh(2), order)
    conductance = np.array([[2.0, 0.3], [0.3, 1.0]])
    every = np.broadcast_to(conductance, (*elements.weights_mm2.shape, 2, 2))
    matrices = elements.directional_stiffness(np.arange(len(elements.cells)), every)
    x, y = elements.points_mm.T
    for p, q, exact in ((x, x, 2.0), (x, y, 0.3), (y, y, 1.0)):
        found = np.einsum("ei,eij,ej->", p[elements.cells], matrices, q[elements.cells])
        assert found == pytest.approx(exact, rel=1e-13)
    alike = elements.directional_stiffness(np.array([1]), np.tile(np.eye(2), (1, len(elements.shapes.points), 1, 1)))
    assert np.allclose(alike[0], elements.stiffness[1], atol=1e-14)


def test_elements_of_second_order_follow_the_circle():
    """Area and circumference converge with the fourth order instead of the second."""
    spokes = np.array([12, 18, 27])
    area, length, straight = [], [], []
    for count in spokes:
        mesh = disc_mesh(2.0, rings=2, spokes=int(count))
        arcs = CircleArcs(mesh.outline, (0.0, 0.0), 2.0)
        elements = FiniteElements(Mesh(mesh.nodes_mm, mesh.elements, arcs=(arcs,)), 2)
        area.append(abs(elements.weights_mm2.sum() / (4 * np.pi) - 1))
        length.append(abs(elements.edge_masses(arcs.edges).sum() / (4 * np.pi) - 1))
        straight.append(abs(FiniteElements(mesh, 2).weights_mm2.sum() / (4 * np.pi) - 1))
    sizes = (1 / spokes).tolist()
    assert_expected_order(area, sizes, 4.0, 0.1)
    assert_expected_order(length, sizes, 4.0, 0.1)
    assert_expected_order(straight, sizes, 2.0, 0.1)


@pytest.mark.parametrize("order", ORDERS)
def test_contacts_share_out_the_electrodes_length(arc_sensor, order):
    sensor = arc_sensor(half_width_rad=0.06)
    contacts = edge_contacts(FiniteElements(sheet_mesh(sensor, size_mm=0.12, order=order), order))
    assert np.allclose(contacts.lengths_mm, 0.12, rtol=1e-4 if order == 1 else 1e-9)
    assert np.allclose(contacts.means.sum(axis=0), 1, atol=1e-14)
    for number, (nodes, mass) in enumerate(zip(contacts.nodes, contacts.masses, strict=True)):
        assert set(np.flatnonzero(contacts.means[:, number])) == set(nodes)
        assert np.abs(mass @ np.ones(len(nodes))).max() < 1e-15  # a constant is no drop over the contact
        assert np.linalg.eigvalsh(mass).min() > -1e-16


def test_sides_of_a_straight_electrode_have_their_exact_masses():
    mesh = square_mesh(1)
    elements = FiniteElements(Mesh(mesh.nodes_mm, mesh.elements, (np.array([[0, 1]]),)), 2)
    masses = elements.edge_masses(np.array([[0, 1]]))[0]
    assert np.allclose(masses, np.array([[4, -1, 2], [-1, 4, 2], [2, 2, 16]]) / 30, atol=1e-15)


SQUARE = square_mesh(2)
FLAT = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, 0.5]])
BELOW = CircleArcs(np.array([[0, 1]]), (0.0, -0.1), float(np.hypot(1, 0.1)))


def carrying(*electrodes) -> FiniteElements:
    return FiniteElements(Mesh(SQUARE.nodes_mm, SQUARE.elements, electrodes), 2)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: FiniteElements(SQUARE, 3), "order is 3; allowed: 1 and 2"),
        (
            lambda: FiniteElements(Mesh(FLAT, np.array([[0, 1, 2]]), arcs=(BELOW,)), 2).stiffness,
            r"bends element 0 .* inside out",
        ),
        (lambda: edge_contacts(carrying()), "carries 0 electrodes"),
        (lambda: edge_contacts(carrying(np.zeros((0, 2), dtype=np.int64))), "edges to electrode 0"),
        (lambda: edge_contacts(carrying(np.array([[0, 8]]))), "nodes 0 and 8 .* by no element"),
        (lambda: point_contacts(carrying(), np.array([0, 9])), "nodes from 0 to 8"),
        (lambda: point_contacts(carrying(), np.array([], dtype=np.int64)), "nodes from"),
        (lambda: point_contacts(carrying(), np.array([1, 1])), "same node"),
    ],
)
def test_what_is_no_element_and_no_electrode_is_refused(call, said):
    with pytest.raises(NumericsError, match=said):
        call()


def test_arcs_off_their_circle_are_refused():
    mesh = disc_mesh(2.0)
    with pytest.raises(RefusedError, match=r"radius 1\.9 mm joins nodes that are not on its circle"):
        Mesh(mesh.nodes_mm, mesh.elements, arcs=(CircleArcs(mesh.outline, (0.0, 0.0), 1.9),))
