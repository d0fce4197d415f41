"""Conductances and contacts far apart: readings keep twelve digits up to the stated bounds, and are refused beyond.

Held against solutions of the same equations in extended precision: residuals are formed from differences of
potentials, so that no current is lost to rounding, and corrections are added until they vanish.
"""

import numpy as np
import pytest

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.eit.forward.model import ForwardModel, point_model
from cbsr_qa.eit.forward.prepared import refine
from cbsr_qa.eit.forward.value_range import CONTACT_RANGE, FAR_CONTACT_RANGE, MOST_CONTRAST, least_and_most


@pytest.fixture(scope="module")
def model(pin_sensor, model_of) -> ForwardModel:
    return model_of(pin_sensor(), size_mm=5.0, contact=0.3)


def refined_readings(model: ForwardModel) -> np.ndarray:
    """Readings in extended precision, to where corrections are of the size of double rounding."""
    cells, contacts = model.elements.cells, model.prepared.contacts
    first, second = np.triu_indices(cells.shape[1], 1)
    ends, others = [cells[:, first].ravel()], [cells[:, second].ravel()]
    links = [(model.conductance[:, None].astype(np.longdouble) * model.stiffness[:, first, second]).ravel()]
    for nodes, mass, z in zip(contacts.nodes, contacts.masses, model.contact_impedance, strict=True):
        first, second = np.triu_indices(len(nodes), 1)
        ends.append(nodes[first])
        others.append(nodes[second])
        links.append(mass[first, second] / np.longdouble(z))
    end, other, link = np.concatenate(ends), np.concatenate(others), np.concatenate(links)
    load = (contacts.means - contacts.means.mean(axis=1, keepdims=True)).astype(np.longdouble)
    potential = model.electrode_fields.astype(np.longdouble)
    for _ in range(20):
        flow = link[:, None] * (potential[other] - potential[end])
        residual = load.copy()
        np.add.at(residual, end, -flow)
        np.add.at(residual, other, flow)
        correction = model.solve(residual.astype(np.float64))
        correction -= correction.mean(axis=0)
        potential += correction
        if np.abs(correction).max() < 1e-14 * np.abs(potential).max():
            break
    else:
        raise AssertionError("the refinement does not end")
    mean = contacts.means.T.astype(np.longdouble) @ potential
    driven, measured = model.pattern.drive_currents(), model.pattern.measure_matrix()
    return ((mean @ driven).T @ measured).astype(np.float64)  # undriven electrodes have no voltage drop of their own


def error(model: ForwardModel) -> float:
    usable = model.pattern.usable()
    exact = refined_readings(model)[usable]
    return float(np.linalg.norm(model.voltages()[usable] - exact) / np.linalg.norm(exact))


def contact(model: ForwardModel, ratio: float) -> np.ndarray:
    return ratio * model.prepared.contacts.lengths_mm / model.conductance[0]


@pytest.mark.parametrize("ratio", [1.001 * CONTACT_RANGE[0], 1e-6, 1.0, 1e6, 0.999 * CONTACT_RANGE[1]])
def test_readings_keep_twelve_digits_over_the_whole_range_of_contacts(model, ratio):
    assert error(model.with_values(contact_impedance=contact(model, ratio))) < 1e-12


@pytest.mark.parametrize(
    ("ratio", "word"), [(1e-15, "raise"), (0.9e-9, "raise"), (1.1e9, "lower"), (1e14, "lower"), (1e16, "lower")]
)
def test_a_contact_out_of_range_is_refused_by_electrode_ratio_and_bounds(model, ratio, word):
    impedance = model.contact_impedance.copy()
    impedance[7] = contact(model, ratio)[7]
    with pytest.raises(NumericsError, match=r"contact impedance 7 is .* 1e-09 to 1e\+09 are allowed") as refused:
        model.with_values(contact_impedance=impedance)
    assert f"{ratio:.3g} of the electrode's length" in refused.value.reason
    assert refused.value.remedy.startswith(word)


def test_small_conductance_under_an_ordinary_contact_is_refused_too(model):
    with pytest.raises(NumericsError, match=r"contact impedance 0 is 0\.3 Ω·mm"):
        model.with_values(conductance=np.full(len(model.conductance), 1e-14))


def islands(model: ForwardModel, parted: float) -> np.ndarray:
    """Good conductors round the electrodes, parted by a poor one: the worst there is for a contrast."""
    x, y = model.mesh.centroids_mm.T
    turn = (np.arctan2(y, x) / (2 * np.pi) * 16 + 0.5) % 1
    return np.where((np.abs(turn - 0.5) < 0.2) & (np.hypot(x, y) > 20), 1.0, parted)


def test_readings_keep_their_digits_up_to_the_largest_contrast(model):
    inclusion = np.hypot(*model.mesh.centroids_mm.T) < 20
    for conductance in (np.where(inclusion, 1e-8, 1.0), np.where(inclusion, 1e8, 1.0)):
        assert error(model.with_values(conductance=conductance)) < 1e-12
    assert error(model.with_values(conductance=islands(model, 1 / MOST_CONTRAST))) < 1e-12


def test_potentials_that_cannot_be_refined_are_refused(model):
    drives = model.prepared.ordered_drives
    useless = np.zeros_like(drives)
    with pytest.raises(NumericsError, match="cannot be refined") as refused:
        refine(model._factors._conductors, drives, lambda load: load, useless, 0)
    assert refused.value.remedy


@pytest.mark.parametrize("contrast", [1.01 * MOST_CONTRAST, 1e12])
def test_a_larger_contrast_is_refused_by_its_elements(model, contrast):
    conductance = model.conductance.copy()
    conductance[5], conductance[9] = contrast**0.5, contrast**-0.5
    with pytest.raises(NumericsError, match=r"conductance 5 is .* and conductance 9 is .* contrast above") as refused:
        model.with_values(conductance=conductance)
    assert refused.value.remedy
    with pytest.raises(NumericsError, match="contrast above"):
        model.with_change_on(np.array([3]), np.array([2 * contrast]))


def test_contrast_in_direction_counts(model):
    conductance = np.tile(np.eye(2), (len(model.conductance), 1, 1, 1))
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    conductance[4, 0] = turn @ np.diag([1.0, 1e9]) @ turn.T
    with pytest.raises(NumericsError, match="conductance 4 is 1e\\+09 S"):
        model.with_values(conductance=conductance)


def test_least_and_most_are_eigenvalues():
    root = np.random.default_rng(3).normal(size=(20, 3, 2, 2))
    conductance = root @ root.transpose(0, 1, 3, 2) + 0.01 * np.eye(2)
    values = np.linalg.eigvalsh(conductance)
    least, most = least_and_most(conductance)
    assert np.allclose(least, values.min(axis=(1, 2)), rtol=1e-9)
    assert np.allclose(most, values.max(axis=(1, 2)), rtol=1e-9)


def test_a_good_contact_far_from_a_poor_conductor_is_refused(model):
    """Near the electrode all is well, but what leaks there counts against what the current must pass."""
    conductance = islands(model, 1e-8)
    impedance = contact(model, 1e-4)
    assert impedance.min() * 1e-8 < FAR_CONTACT_RANGE[0]
    with pytest.raises(NumericsError, match=r"over the sheet's smallest or largest conductance .* 1e-10 to"):
        model.with_values(conductance=conductance, contact_impedance=impedance)


def test_point_electrodes_have_no_contact_to_be_refused(model):
    nodes = np.array([edges[0, 0] for edges in model.mesh.electrode_edges])
    pattern = adjacent_pattern(16)
    plain = point_model(model.mesh, nodes, pattern, np.ones(len(model.mesh.elements)))
    poor = point_model(model.mesh, nodes, pattern, np.full(len(model.mesh.elements), 1e-12))
    assert np.allclose(1e-12 * poor.voltages(), plain.voltages(), rtol=1e-9)


@pytest.mark.parametrize("name", ["conductance", "contact_impedance"])
def test_values_of_other_types_are_refused_not_cast(model, name):
    values = getattr(model, name)
    for wrong in (values + 1j, values.astype(str), values > 0, ["a"] * len(values)):
        with pytest.raises(NumericsError, match="not real numbers"):
            model.with_values(**{name: wrong})


@pytest.mark.parametrize("name", ["conductance", "contact_impedance"])
def test_every_refusal_of_values_has_a_remedy(model, name):
    for wrong, said in ((0 * getattr(model, name), "positive finite"), (getattr(model, name)[1:], "has shape")):
        with pytest.raises(NumericsError, match=said) as refused:
            model.with_values(**{name: wrong})
        assert refused.value.remedy
