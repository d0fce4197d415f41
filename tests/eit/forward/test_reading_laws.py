"""Laws that readings and their derivatives obey on every sheet, for elements of both orders."""

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.testing.numerics import assert_adjoint, assert_expected_order

COUNT = 8


@pytest.fixture(scope="module", params=[1, 2])
def uneven(request, pin_sensor, model_of) -> ForwardModel:
    """A sheet with a seeded, uneven conductance: symmetry hides no mistakes."""
    plain = model_of(pin_sensor(count=COUNT), size_mm=8.0)
    random = np.random.default_rng(5)
    conductance = np.exp(random.normal(0, 0.5, len(plain.mesh.elements)))
    return ForwardModel(plain.mesh, plain.pattern, conductance, random.uniform(0.1, 1, COUNT), order=request.param)


def test_readings_and_their_derivatives_are_reciprocal(uneven):
    voltages, slopes = uneven.voltages(), uneven.contact_jacobian()
    assert np.abs(voltages - voltages.T).max() < 1e-13 * np.abs(voltages).max()
    assert np.abs(slopes - slopes.transpose(1, 0, 2)).max() < 1e-12 * np.abs(slopes).max()


def test_the_solve_is_its_own_adjoint(uneven):
    size = len(uneven.electrode_fields)
    assert_adjoint(uneven.solve, uneven.solve, (size, 2), (size, 2), tolerance=1e-11)


def test_driven_current_reaches_the_sheet_and_potentials_sum_to_zero(uneven):
    currents = np.zeros_like(uneven.electrode_fields)
    cells, contacts = uneven.elements.cells, uneven.prepared.contacts
    np.add.at(currents, cells, uneven.element_matrices(np.arange(len(cells))) @ uneven.electrode_fields[cells])
    for number, nodes in enumerate(contacts.nodes):
        assert np.allclose(currents[nodes].sum(axis=0), np.eye(COUNT)[number] - 1 / COUNT, atol=1e-10)
    inner = np.setdiff1d(np.arange(len(currents)), np.concatenate(contacts.nodes))
    assert np.abs(currents[inner]).max() < 1e-10
    assert np.abs(uneven.transfer_impedance.sum(axis=0)).max() < 1e-12 * np.abs(uneven.transfer_impedance).max()


@given(factor=st.floats(1e-14, 1e14))
@drawn(15)
def test_voltages_scale_with_resistance(uneven, factor):
    """Only ratios count: no conductance is extreme by itself."""
    scaled = uneven.with_values(
        conductance=factor * uneven.conductance, contact_impedance=uneven.contact_impedance / factor
    )
    assert np.allclose(scaled.voltages() * factor, uneven.voltages(), rtol=1e-9, atol=0)


def test_readings_scale_exactly_with_sheet_and_contacts(uneven):
    """V(aγ, z/a) = V/a, so Σ γ ∂V/∂γ − Σ z ∂V/∂z = −V to rounding."""
    total = uneven.jacobian() @ uneven.conductance - uneven.contact_jacobian() @ uneven.contact_impedance
    assert np.allclose(total, -uneven.voltages(), rtol=0, atol=1e-11 * np.abs(total).max())


@pytest.mark.parametrize(
    ("what", "jacobian", "steps"),
    [
        ("conductance", "jacobian", (0.002, 0.001, 0.0005)),
        ("contact_impedance", "contact_jacobian", (0.008, 0.004, 0.002)),
    ],
)
def test_derivatives_are_those_of_the_readings(uneven, what, jacobian, steps):
    values = getattr(uneven, what)
    direction = np.random.default_rng(6).normal(0, 1, len(values)) * values
    linear, errors = getattr(uneven, jacobian)() @ direction, []
    for step in steps:
        ahead, behind = (
            uneven.with_values(**{what: values + sign * step * direction}).voltages() for sign in (1, -1)
        )
        errors.append(float(np.abs((ahead - behind) / (2 * step) - linear).max()))
    assert_expected_order(errors, steps, 2.0, 0.05)
    assert errors[-1] < 1e-4 * np.abs(linear).max()


def test_chosen_rows_of_the_jacobian(uneven):
    drive, measure = np.nonzero(np.triu(uneven.pattern.usable()))
    rows = uneven.jacobian_rows(drive, measure)
    assert rows.shape == (20, len(uneven.mesh.elements))  # of eight electrodes, reciprocals left out
    assert np.allclose(rows, uneven.jacobian()[drive, measure], rtol=1e-13, atol=0)


def test_a_better_sheet_and_better_contacts_lower_every_driving_point_resistance(uneven):
    driven = np.arange(COUNT), np.arange(COUNT)
    assert (uneven.jacobian()[driven] <= 0).all()
    by_contact = uneven.contact_jacobian()[driven]
    assert (by_contact >= 0).all()
    for number, own in enumerate(by_contact):
        ends = [number, (number + 1) % COUNT]
        assert own[ends].min() > 100 * np.delete(own, ends).max(initial=0)


@pytest.mark.parametrize("contact", [1e-3, 1e6])
def test_extreme_contacts_keep_their_derivative(uneven, contact):
    slope = uneven.with_values(contact_impedance=np.full(COUNT, contact)).contact_jacobian()[0, 0, 0]
    step = 1e-2 * contact * np.eye(COUNT)[0]
    ahead, behind = (uneven.with_values(contact_impedance=contact + sign * step).voltages()[0, 0] for sign in (1, -1))
    assert (ahead - behind) / (2 * step[0]) == pytest.approx(slope, rel=1e-3)
