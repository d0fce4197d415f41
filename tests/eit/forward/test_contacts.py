"""Derivatives of readings by contact impedance."""

import numpy as np
import pytest

from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.testing import assert_expected_order


@pytest.fixture(scope="module", params=[1, 2])
def uneven(request, pin_sensor, model_of) -> ForwardModel:
    """A sheet with a seeded, uneven conductance: symmetry hides no mistakes."""
    plain = model_of(pin_sensor(count=8), size_mm=8.0)
    random = np.random.default_rng(5)
    conductance = np.exp(random.normal(0, 0.5, len(plain.mesh.elements)))
    return ForwardModel(plain.mesh, plain.pattern, conductance, random.uniform(0.1, 1, 8), order=request.param)


def test_the_closed_form_is_the_derivative(uneven):
    direction = np.random.default_rng(8).normal(0, 1, 8) * uneven.contact_impedance
    linear = uneven.contact_jacobian() @ direction
    steps = (0.04, 0.02, 0.01)
    errors = []
    for step in steps:
        ahead, behind = (
            uneven.changed(contact_impedance=uneven.contact_impedance + sign * step * direction).voltages()
            for sign in (1, -1)
        )
        errors.append(float(np.abs((ahead - behind) / (2 * step) - linear).max()))
    assert_expected_order(errors, steps, 2.0, 0.05)
    assert errors[-1] < 1e-3 * np.abs(linear).max()


def test_readings_scale_exactly_with_sheet_and_contacts(uneven):
    """V(aγ, z/a) = V/a, so Σ γ ∂V/∂γ − Σ z ∂V/∂z = −V to rounding."""
    total = uneven.jacobian() @ uneven.conductance - uneven.contact_jacobian() @ uneven.contact_impedance
    assert np.allclose(total, -uneven.voltages(), rtol=0, atol=1e-11 * np.abs(total).max())


def test_a_worse_contact_never_lowers_a_driving_point_resistance(uneven):
    own = uneven.contact_jacobian()[np.arange(8), np.arange(8)]
    assert (own >= 0).all()
    for number in range(8):
        assert own[number, [number, (number + 1) % 8]].min() > 100 * np.delete(
            own[number], [number, (number + 1) % 8]
        ).max(initial=0)


def test_readings_and_derivatives_are_reciprocal(uneven):
    slopes = uneven.contact_jacobian()
    assert np.abs(slopes - slopes.transpose(1, 0, 2)).max() < 1e-12 * np.abs(slopes).max()


@pytest.mark.parametrize("contact", [1e-3, 1e6])
def test_extreme_contacts_keep_their_derivative(uneven, contact):
    model = uneven.changed(contact_impedance=np.full(8, contact))
    slope = model.contact_jacobian()[0, 0, 0]
    step = 1e-2 * contact
    impedance = np.full(8, contact)
    impedance[0] += step
    ahead = uneven.changed(contact_impedance=impedance).voltages()[0, 0]
    impedance[0] -= 2 * step
    behind = uneven.changed(contact_impedance=impedance).voltages()[0, 0]
    assert (ahead - behind) / (2 * step) == pytest.approx(slope, rel=1e-3)
