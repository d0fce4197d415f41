"""What a load covers of elements, and what a cut element conducts."""

import numpy as np
import pytest
from disc_meshes import square_mesh
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import PolygonFootprint, RoundFootprint
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.forward.coverage import Cover, cover, disc_coverage
from cbsr_qa.eit.forward.elements import FiniteElements
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.loads.local import LocalUpdate
from cbsr_qa.eit.loads.pinned_disc import PinnedDisc
from cbsr_qa.eit.loads.round_load import RoundLoadModel, RoundLoads
from cbsr_qa.eit.mesh.sheet import sheet_mesh


@pytest.fixture(scope="module", params=[1, 2])
def elements(request) -> FiniteElements:
    return FiniteElements(square_mesh(9, size_mm=10.0), request.param)


def half_plane(distance: float, angle: float) -> PolygonFootprint:
    """A strip so long that the square sees its near side alone: points with x·n > distance from the centre."""
    normal, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    near, far = 5.0 + distance * normal, 5.0 + 100 * normal
    return PolygonFootprint(np.array([near - 100 * along, far - 100 * along, far + 100 * along, near + 100 * along]))


@given(x=st.floats(0, 10), y=st.floats(0, 10), radius=st.floats(0.3, 6))
@drawn(20)
def test_shares_are_those_of_exact_clipping(elements, x, y, radius):
    load = cover(elements, RoundFootprint(x, y, radius))
    expected, fraction = disc_coverage(elements.mesh, x, y, radius)
    assert np.array_equal(load.elements, expected)
    assert np.allclose(load.share, fraction, atol=1e-12)
    assert np.allclose(load.spread.mean(axis=1), load.share, atol=1e-12)


@given(part=st.floats(0.02, 0.98), corner=st.integers(0, 2))
@drawn(30)
def test_first_moments_are_those_of_the_covered_part(part, corner):
    """A cut parallel to a side leaves a corner of known centroid; found to 3 % of the range."""
    mesh = Mesh(np.array([[0.0, 0.0], [3.0, 0.4], [1.0, 2.0]]), np.array([[0, 1, 2]]))
    elements = FiniteElements(mesh, 2)
    ends = mesh.nodes_mm[corner] + part * (np.delete(mesh.nodes_mm, corner, axis=0) - mesh.nodes_mm[corner])
    load = cover(elements, PolygonFootprint(np.vstack([mesh.nodes_mm[corner], ends])))
    assert load.share[0] == pytest.approx(part**2)
    centroid = np.full(3, part / 3)
    centroid[corner] = 1 - 2 * part / 3
    points = elements.shapes.points
    expected = part**2 * (1 + 12 * (points - 1 / 3) @ (centroid - 1 / 3))  # ∫ λ_i λ_j = (1 + δ_ij)/12 of the area
    assert np.allclose(load.spread[0], expected, atol=0.03)


def test_normals_are_those_of_the_outline(elements):
    for footprint, normal in (
        (half_plane(0.3, 0.7), np.array([np.cos(0.7), np.sin(0.7)])),
        (RoundFootprint(4.0, 5.0, 3.0), None),
    ):
        load = cover(elements, footprint)
        cut = load.share < 1 - 1e-12
        places = elements.shapes.points @ elements.mesh.corners_mm[load.elements]
        expected = places - [4.0, 5.0] if normal is None else np.broadcast_to(normal, places.shape)
        expected = expected / np.hypot(expected[..., 0], expected[..., 1])[..., None]
        assert np.allclose(np.abs((load.across * expected).sum(axis=-1))[cut], 1, atol=1e-6)
        assert not load.across[~cut].any()


def test_a_cut_element_conducts_as_a_stack_of_layers(elements):
    """Along the outline the conductances add, across it the resistances; on average over the element."""
    points = elements.weights_mm2.shape[1]
    even = Cover(np.array([0]), np.array([0.25]), np.full((1, points), 0.25), np.tile([1.0, 0.0], (1, points, 1)))
    change = even.change(np.full(5, 2.0), 3.0)
    assert np.allclose(change[0, :, 1, 1] + 2, 0.25 * 8 + 0.75 * 2)
    assert np.allclose(1 / (change[0, :, 0, 0] + 2), 0.25 / 8 + 0.75 / 2)
    assert not change[0, :, 0, 1].any()


@given(log_factor=st.floats(-18, 18), x=st.floats(2, 8), radius=st.floats(0.2, 4))
@drawn(40)
def test_any_contrast_leaves_a_conductor(elements, log_factor, x, radius):
    load = cover(elements, RoundFootprint(x, 4.0, radius))
    conductance = np.full(len(elements.cells), 3.0)
    matrices = 3.0 * np.eye(2) + load.change(conductance, np.expm1(log_factor))
    smallest, largest = np.moveaxis(np.linalg.eigvalsh(matrices), -1, 0)
    assert smallest.min() > 0.4 * 3.0 * min(1, np.exp(log_factor))
    assert largest.max() < 2.5 * 3.0 * max(1, np.exp(log_factor))


def test_a_small_change_is_linear(elements):
    load = cover(elements, RoundFootprint(5.0, 5.0, 3.1))
    conductance = np.linspace(1, 2, len(elements.cells))
    change = load.change(conductance, 1e-7) / 1e-7
    expected = load.spread[..., None, None] * np.eye(2) * conductance[load.elements, None, None, None]
    assert np.allclose(change, expected, atol=1e-6)
    assert not load.change(conductance, 0.0).any()


@pytest.mark.parametrize("relative", [-1.0, -2.0, np.nan, np.inf])
def test_changes_without_conductance_are_refused(elements, relative):
    with pytest.raises(NumericsError, match="no positive conductance"):
        cover(elements, RoundFootprint(5.0, 5.0, 3.0)).change(np.ones(len(elements.cells)), relative)


def test_a_load_beside_the_sheet_covers_nothing(elements):
    for footprint in (RoundFootprint(50.0, 0.0, 3.0), PolygonFootprint(np.array([[50.0, 0], [60, 0], [60, 9]]))):
        load = cover(elements, footprint)
        assert not load.elements.size
        assert load.change(np.ones(len(elements.cells)), 0.1).shape == (0, elements.weights_mm2.shape[1], 2, 2)


def test_signals_of_loads_agree_with_the_exact_ones(pin_sensor):
    """γ +50 % under the 13 mm head: scaling by the covered share alone errs by 3 to 5 %."""
    sensor = pin_sensor()
    usable = sensor.pattern.usable()
    exact_model = RoundLoadModel(PinnedDisc(50.0, sensor.electrodes, 0.3), sensor.pattern)
    for order, size, allowed in ((1, 3.0, 0.025), (2, 8.0, 0.008)):
        mesh = sheet_mesh(sensor, size_mm=size, order=order)
        model = ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), np.full(16, 0.3), order=order)
        local = LocalUpdate(model)
        for x, y in ((0.0, 0.0), (30.0, 0.0), (-15.0, 15.0), (7.3, -33.0)):
            exact = exact_model.readings(
                RoundLoads.from_contrast(np.array([[x, y]]), np.array([6.5]), np.array([0.5]))
            ).change[0][usable]
            load = cover(model.elements, RoundFootprint(x, y, 6.5))
            for change, bound in ((load.change(model.conductance, 0.5), allowed), (0.5 * load.share, 0.1)):
                found = (local.voltages(load.elements, change) - model.voltages())[usable]
                assert np.linalg.norm(found - exact) < bound * np.linalg.norm(exact)
