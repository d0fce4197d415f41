"""Same mesh in, same numbers out as EIDORS on Octave."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from tiers import rest_but

from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.eit.forward.model import ForwardModel, point_model
from cbsr_qa.eit.inverse.dual import dual_matrix, dual_spectrum
from cbsr_qa.eit.inverse.noise_figures import NoiseFigureForm, hyperparameter_for, noise_figure
from cbsr_qa.eit.inverse.priors import Prior, laplace, laplace_matrix, noser

#: Complete electrodes on two meshes, and point electrodes.
FILES = ("cem2node_c2C0", "cem_distmesh_d2d1c", "pem_c2c0")


@dataclass
class Reference:
    model: ForwardModel
    values: dict[str, np.ndarray]

    @property
    def current(self) -> float:
        return float(np.abs(self.values["stim"]).max())

    def readings(self, frame: np.ndarray) -> np.ndarray:
        """(drives, measures, ...) in EIDORS's order, sign and current."""
        stimulation = self.values["mi"].ravel().astype(int) - 1
        plus, minus = self.values["mp"].argmax(axis=1), self.values["mp"].argmin(axis=1)
        sign = np.where((plus + 1) % 16 == minus, 1.0, -1.0)
        pair = np.where(sign > 0, plus, minus)
        drive_sign = np.sign(self.values["stim"][stimulation, stimulation])
        return (sign * drive_sign * self.current * np.moveaxis(frame[stimulation, pair], 0, -1)).T

    def matrix(self, name: str) -> sparse.csc_matrix:
        rows, columns = (self.values[f"{name}{axis}"].ravel().astype(int) - 1 for axis in "ij")
        return sparse.csc_matrix((self.values[f"{name}v"].ravel(), (rows, columns)))


@lru_cache
def loaded(path: Path) -> Reference:
    with np.load(path) as file:
        values = dict(file)
    elements = values["elems"].astype(np.int64) - 1
    first, second, third = (values["nodes"][elements[:, k]] for k in range(3))
    turned = np.linalg.det(np.stack([second - first, third - first], axis=1)) < 0
    elements[turned] = elements[turned][:, ::-1]
    plain, pattern = np.ones(len(elements)), adjacent_pattern(16)
    if values["eln"].shape[1] == 1:
        nodes = values["eln"].ravel().astype(np.int64) - 1
        return Reference(point_model(Mesh(values["nodes"], elements), nodes, pattern, plain), values)
    boundary = values["bnd"].astype(np.int64) - 1
    edges = tuple(boundary[np.isin(boundary, nodes - 1).all(axis=1)] for nodes in values["eln"])
    model = ForwardModel(Mesh(values["nodes"], elements, edges), pattern, plain, values["zc"].ravel())
    return Reference(model, values)


@pytest.fixture(scope="module", params=FILES)
def reference(request: pytest.FixtureRequest, shared: Path) -> Reference:
    return loaded(shared / "oracle" / f"{request.param}.npz")


@pytest.fixture(scope="module")
def points(shared: Path) -> Reference:
    return loaded(shared / "oracle" / "pem_c2c0.npz")


def test_voltages_of_even_and_uneven_sheets(reference):
    uneven = reference.model.with_values(conductance=reference.values["sig"].ravel())
    for model, name in ((reference.model, "v_homog"), (uneven, "v_inhomog")):
        expected = reference.values[name].ravel()
        assert np.abs(reference.readings(model.voltages()) - expected).max() < 1e-10 * np.abs(expected).max()


def test_jacobian_of_even_and_uneven_sheets(reference):
    uneven = reference.model.with_values(conductance=reference.values["sig"].ravel())
    columns = reference.values["J_cols"] if "J_cols" in reference.values else slice(None)
    for model, name in ((reference.model, "J"), (uneven, "Ji")):
        if name in reference.values:
            found, expected = reference.readings(model.jacobian())[:, columns], reference.values[name]
            allowed = 1e-6 if expected.dtype == np.float32 else 1e-10
            assert np.abs(found - expected).max() < allowed * np.abs(expected).max()


def test_potentials_of_all_nodes_and_the_system_matrix_of_points(points):
    """EIDORS grounds one node; our potentials are the same up to a constant in each column."""
    found, expected = points.model.electrode_fields @ points.values["stim"], points.values["volt_homog"]
    assert np.abs(found - found[:1] - expected + expected[:1]).max() < 1e-10 * np.abs(expected).max()
    cells, theirs, ours = points.model.elements.cells, points.matrix("S"), np.zeros((313, 313))
    np.add.at(ours, (cells[:, :, None], cells[:, None, :]), points.model.stiffness)
    assert np.abs(ours - theirs).max() < 1e-12 * np.abs(theirs).max()


def test_points_have_no_contact_impedance(points):
    other = points.model.with_values(contact_impedance=np.full(16, 1e3))
    assert np.array_equal(other.voltages(), points.model.voltages())
    assert not points.model.contact_jacobian().any()


PRIORS = ("NOSER", "Laplace", "Tikhonov")  # in the files' order


def prior_of(name: str, mesh: Mesh, jacobian: np.ndarray) -> Prior | np.ndarray:
    made = {"NOSER": lambda: noser(jacobian, 0.5), "Laplace": lambda: laplace(mesh)}
    return made[name]() if name in made else np.ones(jacobian.shape[1])


@pytest.mark.parametrize("name", rest_but({"NOSER"}, PRIORS))
def test_images_and_noise_figures(reference, name):
    """Noise figures to every digit printed, images to 1e-8, matrices (float32) to 1e-6."""
    values, jacobian = reference.values, reference.readings(reference.model.jacobian())
    number, prior = PRIORS.index(name), prior_of(name, reference.model.mesh, jacobian)
    homogeneous = values["v_homog"].ravel()
    change, signal = values["v_inhomog"].ravel() - homogeneous, values["v_tgt"].ravel() - homogeneous
    areas, parameters = values["vol"].ravel(), values["hps"].ravel()
    for hyperparameter, expected in zip(parameters, values["NF"][number], strict=True):
        matrix = dual_matrix(jacobian, prior, hyperparameter)
        eidors = noise_figure(matrix, signal, areas, form=NoiseFigureForm.EIDORS)
        assert eidors == pytest.approx(expected, rel=1e-8)
        assert 1.0 < noise_figure(matrix, signal, areas) / eidors < 1.25
    largest = dual_matrix(jacobian, prior, parameters[0])
    expected_image = values["rec"][:, number]
    assert np.abs(largest @ change - expected_image).max() < 1e-8 * np.abs(expected_image).max()
    if values["RMn"].size:
        expected_matrix = values["RMn"][:, :, number]
        assert np.abs(largest - expected_matrix).max() < 1e-6 * np.abs(expected_matrix).max()


def test_prior_weights(reference):
    values, mesh = reference.values, reference.model.mesh
    jacobian = reference.readings(reference.model.jacobian())
    assert np.allclose(noser(jacobian, 0.5), values["nosd"].ravel(), rtol=1e-10)
    assert abs(reference.matrix("L") - laplace_matrix(mesh)).max() == 0


@pytest.mark.parametrize("name", rest_but({"NOSER"}, PRIORS))
def test_hyperparameter_for_noise_figure_one(reference, name):
    """EIDORS searches coarsely, and for its own form; ours lies within the spread of the two forms."""
    values, number = reference.values, PRIORS.index(name)
    jacobian, areas = reference.readings(reference.model.jacobian()), values["vol"].ravel()
    prior, theirs = prior_of(name, reference.model.mesh, jacobian), values["hpNF1"].ravel()[number]
    signal = values["v_tgt"].ravel() - values["v_homog"].ravel()
    eidors = noise_figure(dual_matrix(jacobian, prior, theirs), signal, areas, form=NoiseFigureForm.EIDORS)
    assert eidors == pytest.approx(1, abs=0.02 if "J_cols" in values else 1e-3)
    found = hyperparameter_for(1.0, dual_spectrum(jacobian, prior), signal, areas)
    assert 1.0 < found / theirs < 1.25


def test_the_two_forms_differ_as_published(points):
    values = points.values
    signal = values["v_tgt"].ravel() - values["v_homog"].ravel()
    matrix = dual_matrix(values["J"], noser(values["J"], 0.5), 0.3)
    assert noise_figure(matrix, signal, values["vol"].ravel()) == pytest.approx(0.494, abs=5e-4)
