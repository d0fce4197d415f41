"""The load without a mesh: against boundary integrals, an exact inclusion, finite elements, its own differences."""

from dataclasses import replace

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st
from tiers import rest_but

from benchmarks.reference_solutions import fitted_mesh, pin_transfer_impedance, point_transfer_impedance
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout, PlacedElectrodes
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.loads.pinned_disc import PinnedDisc
from cbsr_qa.eit.loads.round_load import RoundLoadModel, RoundLoads
from cbsr_qa.eit.mesh.sheet import sheet_mesh
from cbsr_qa.testing.numerics import assert_expected_order

PATTERN = adjacent_pattern(16)
USED = PATTERN.usable()


@pytest.fixture(scope="module")
def model(pin_sensor) -> RoundLoadModel:
    return RoundLoadModel(PinnedDisc(50.0, pin_sensor().electrodes, 0.5), PATTERN)


def one(x: float, y: float, strength: float, square: float) -> RoundLoads:
    return RoundLoads(np.array([[x, y]]), np.array([strength]), np.array([square]))


def change(model: RoundLoadModel, x: float, y: float, radius: float, contrast: float) -> np.ndarray:
    load = RoundLoads.from_contrast(np.array([[x, y]]), np.array([radius]), np.array([contrast]))
    return model.readings(load).change[0]


@pytest.mark.parametrize(
    "layout",
    [
        ElectrodeLayout(16, ElectrodeKind.PIN, 48.0, 0.65, 0.0, True),
        ElectrodeLayout(8, ElectrodeKind.PIN, 45.0, 3.0, 17.0, False),
        ElectrodeLayout(5, ElectrodeKind.PIN, 20.0, 6.0, 0.0, True),
    ],
)
def test_unloaded_readings_agree_with_boundary_integrals(layout):
    for contact in (1e-3, 0.5, 50.0):
        exact = pin_transfer_impedance(50.0, 1.0, layout, contact)
        found = PinnedDisc(50.0, layout, contact).transfer_impedance()
        assert np.abs(found - exact).max() < 1e-7 * np.abs(exact).max()


def test_pins_one_by_one_are_those_of_a_ring(pin_sensor):
    ring = pin_sensor().electrodes
    places = PlacedElectrodes(ElectrodeKind.PIN, tuple(map(tuple, ring.positions_mm().tolist())), ring.width_mm)
    both = [PinnedDisc(50.0, electrodes, 0.5) for electrodes in (ring, places)]
    assert np.allclose(both[0].transfer_impedance(), both[1].transfer_impedance(), rtol=1e-12, atol=1e-14)


def test_a_pin_in_the_centre_is_no_special_case():
    places = ((0.0, 0.0), (30.0, 0.0), (0.0, 30.0), (-30.0, 0.0))
    central, beside = (
        PinnedDisc(50.0, PlacedElectrodes(ElectrodeKind.PIN, ((x, 0.0), *places[1:]), 2.0), 0.5).transfer_impedance()
        for x in (0.0, 0.02)
    )
    assert np.isfinite(central).all()
    assert np.abs(central - beside).max() < 1e-3


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (21.0, -3.0), (-10.0, 30.0), (40.0, 1.0)])
@pytest.mark.parametrize("square", rest_but({-30.0}, [42.25, 3.0, -30.0]))
def test_slopes_are_those_of_differences(model, monkeypatch, x, y, square):
    monkeypatch.setattr("cbsr_qa.eit.loads.round_load._ERROR", 1e-14)  # of a series hardly cut: slopes converge later
    monkeypatch.setattr("cbsr_qa.eit.loads.round_load._MOST", 40)
    at = np.array([x, y, 8.0, square])
    slope = model.readings(one(*at)).slope[0]
    for parameter, step in enumerate((2e-4, 2e-4, 1e-3, 1e-3)):
        ahead, behind = (model.readings(one(*(at + s * step * np.eye(4)[parameter]))).change[0] for s in (1, -1))
        difference = (ahead - behind) / (2 * step)
        assert np.linalg.norm(slope[parameter] - difference) < 2e-6 * np.linalg.norm(difference)


@pytest.mark.parametrize(
    ("x", "y", "radius"), [(0.0, 0.0, 6.5), (21.0, 3.0, 4.0), (30.0, 0.0, 10.0), (40.0, 0.0, 6.5)]
)
def test_the_series_is_long_enough(model, monkeypatch, x, y, radius):
    load = RoundLoads.from_contrast(np.array([[x, y]]), np.array([radius]), np.array([0.5]))
    usual = model.readings(load)
    monkeypatch.setattr("cbsr_qa.eit.loads.round_load._ERROR", 1e-14)
    monkeypatch.setattr("cbsr_qa.eit.loads.round_load._MOST", 40)
    whole = model.readings(load)
    assert np.linalg.norm((usual.change - whole.change)[0][USED]) < 1e-6 * np.linalg.norm(whole.change[0][USED])
    for own, exact in zip(usual.slope[0], whole.slope[0], strict=True):
        assert np.linalg.norm((own - exact)[USED]) < 3e-4 * np.linalg.norm(exact[USED])


def test_a_central_disc_agrees_with_the_exact_inclusion():
    """Pins become points on the edge as they shrink and move out; the rest is second order in the gap."""
    angles = 2 * np.pi * np.arange(16) / 16
    exact, plain = (
        point_transfer_impedance(sheet, angles)
        for sheet in (ConcentricSheet(50.0, 1.0, 20.0, 3.0), ConcentricSheet(50.0, 1.0))
    )
    expected = ((exact - plain) @ PATTERN.drive_currents()).T @ PATTERN.measure_matrix()
    gaps, errors = (4.0, 2.0, 1.0, 0.5), []
    for gap in gaps:
        layout = ElectrodeLayout(16, ElectrodeKind.PIN, 50.0 - gap, gap / 100, 0.0, True)
        model = RoundLoadModel(PinnedDisc(50.0, layout, 1e-3), PATTERN)
        found = change(model, 0.0, 0.0, 20.0, 2.0)
        errors.append(np.abs(found - expected)[USED].max() / np.abs(expected[USED]).max())
    assert_expected_order(errors, gaps, 2.0)
    assert errors[-1] < 5e-3


@pytest.mark.parametrize(
    ("x", "y", "radius", "contrast"),
    rest_but({39.2}, [(30.0, 0.0, 6.5, 0.5), (39.2, 7.8, 6.5, -0.7), (5.0, -30.0, 10.0, 4.0)]),
)
def test_finite_elements_converge_to_it(pin_sensor, model, x, y, radius, contrast):
    expected = change(model, x, y, radius, contrast)[USED]
    errors = []
    for size in (6.0, 3.0):
        mesh, inside = fitted_mesh(sheet_mesh(pin_sensor(), size_mm=size), (x, y), radius)
        plain = ForwardModel(mesh, PATTERN, np.ones(len(mesh.elements)), np.full(16, 0.5), order=2)
        loaded = plain.with_values(conductance=1 + contrast * inside)
        found = (loaded.voltages() - plain.voltages())[USED]
        errors.append(float(np.linalg.norm(found - expected) / np.linalg.norm(expected)))
    assert errors[1] < 1e-3, errors
    assert errors[1] < errors[0] / 3


@given(
    x=st.floats(-35, 35), y=st.floats(-35, 35), radius=st.floats(0.5, 8), log_factor=st.floats(-8, 8)
)  # fmt: skip
@drawn(25)
def test_reciprocity_and_rotation_by_one_electrode(model, x, y, radius, log_factor):
    if not model.surroundings.clearance_mm(np.array([[x, y]]))[0] > 1.2 * radius:
        return
    contrast = np.expm1(log_factor)
    found = change(model, x, y, radius, contrast)
    smallest = np.finfo(np.float64).tiny  # below it a double has fewer digits than the bounds ask for
    assert np.abs(found - found.T).max() <= 1e-11 * np.abs(found).max() + smallest
    turn = 2 * np.pi / 16
    turned = change(model, x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), radius, contrast)
    assert np.abs(np.roll(found, (1, 1), (0, 1)) - turned).max() <= 1e-7 * np.abs(found).max() + smallest


@pytest.mark.parametrize("place", [(48.0, 0.0), (47.9, 0.0), (60.0, 0.0), (np.nan, 0.0)])
def test_a_load_where_the_field_has_no_power_series_is_refused(model, place):
    """On a pin a series of 1e18 V/A came out."""
    loads = RoundLoads(np.array([[0.0, 0.0], place]), np.full(2, 1.0), np.full(2, 6.5**2))
    with pytest.raises(NumericsError, match=r"on an electrode or off the sheet|not a finite number"):
        model.readings(loads)


def test_a_dipole_is_left_where_the_disc_vanishes(model):
    """At equal strength readings stop depending on the size as it goes to nothing, linearly in its square."""
    point = model.readings(one(14.0, 9.0, 0.5, 0.0)).change[0]
    squares = (4.0, 2.0, 1.0)
    away = [np.abs(model.readings(one(14.0, 9.0, 0.5, q)).change[0] - point).max() for q in squares]
    assert_expected_order(away, squares, 1.0, 0.1)


def test_many_at_once_are_each_alone(model):
    rng = np.random.default_rng(5)
    places = rng.uniform(-28, 28, (20, 2))
    many = RoundLoads.from_contrast(places, rng.uniform(2, 8, 20), rng.uniform(-0.5, 2, 20))
    together = model.readings(many)
    for k in range(20):
        alone = model.readings(one(*places[k], many.strength_mm2[k], many.square_mm2[k]))
        assert np.allclose(together.change[k], alone.change[0], rtol=0, atol=1e-6 * np.abs(alone.change).max())


def test_clearance_is_to_the_nearer_of_pin_and_edge(model):
    clear = model.surroundings.clearance_mm(np.array([[0.0, 0.0], [40.0, 0.0], [0.0, -49.5]]))
    assert clear == pytest.approx([48 - 0.325, 8 - 0.325, 0.5])


def test_what_has_no_exact_fields_is_refused(pin_sensor, arc_sensor):
    with pytest.raises(NumericsError, match="pins only"):
        PinnedDisc(1.0, arc_sensor().electrodes, 0.5)
    layout = pin_sensor().electrodes
    for wrong in (replace(layout, ring_radius_mm=49.8), replace(layout, width_mm=18.0)):
        with pytest.raises(NumericsError, match="clear of each other"):
            PinnedDisc(50.0, wrong, 0.5)
