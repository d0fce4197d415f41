"""Same mesh in, same numbers out as EIDORS on Octave."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from cbsr_qa.domain.sensor import Mesh, adjacent_pattern
from cbsr_qa.eit.forward import ForwardModel
from cbsr_qa.eit.inverse import NoiseFigureForm, hyperparameter_for, noise_figure
from cbsr_qa.eit.inverse.dual import dual_matrix, dual_spectrum
from cbsr_qa.eit.inverse.priors import Prior, laplace, laplace_matrix, noser

FILES = ("cem2node_c2C0", "cem_distmesh_d2d1c")


@dataclass
class Reference:
    model: ForwardModel
    values: dict[str, np.ndarray]
    scale: float

    def readings(self, frame: np.ndarray) -> np.ndarray:
        """(drives, measures, ...) in EIDORS's order, sign and current."""
        stimulation = self.values["mi"].ravel().astype(int) - 1
        plus, minus = self.values["mp"].argmax(axis=1), self.values["mp"].argmin(axis=1)
        sign = np.where((plus + 1) % 16 == minus, 1.0, -1.0)
        pair = np.where(sign > 0, plus, minus)
        drive_sign = np.sign(self.values["stim"][stimulation, stimulation])
        return (sign * drive_sign * self.scale * np.moveaxis(frame[stimulation, pair], 0, -1)).T


@pytest.fixture(scope="module", params=FILES)
def reference(request: pytest.FixtureRequest, shared: Path) -> Reference:
    with np.load(shared / "oracle" / f"{request.param}.npz") as file:
        values = dict(file)
    elements = values["elems"].astype(np.int64) - 1
    first, second, third = (values["nodes"][elements[:, k]] for k in range(3))
    turned = np.linalg.det(np.stack([second - first, third - first], axis=1)) < 0
    elements[turned] = elements[turned][:, ::-1]
    boundary = values["bnd"].astype(np.int64) - 1
    edges = tuple(boundary[np.isin(boundary, nodes - 1).all(axis=1)] for nodes in values["eln"])
    mesh = Mesh(values["nodes"], elements, edges)
    model = ForwardModel(mesh, adjacent_pattern(16), np.ones(len(elements)), values["zc"].ravel())
    return Reference(model, values, float(np.abs(values["stim"]).max()))


def test_voltages(reference):
    found = reference.readings(reference.model.voltages())
    expected = reference.values["v_homog"].ravel()
    assert np.abs(found - expected).max() < 1e-10 * np.abs(expected).max()


def test_voltages_of_an_uneven_sheet(reference):
    model = reference.model
    uneven = ForwardModel(model.mesh, model.pattern, reference.values["sig"].ravel(), model.contact_impedance)
    expected = reference.values["v_inhomog"].ravel()
    assert np.abs(reference.readings(uneven.voltages()) - expected).max() < 1e-10 * np.abs(expected).max()


def test_jacobian(reference):
    found = reference.readings(reference.model.jacobian())
    expected = reference.values["J"]
    allowed = 1e-6 if expected.dtype == np.float32 else 1e-10
    columns = reference.values["J_cols"] if "J_cols" in reference.values else slice(None)
    assert np.abs(found[:, columns] - expected).max() < allowed * np.abs(expected).max()


PRIORS = ("NOSER", "Laplace", "Tikhonov")  # in the files' order


def prior_of(name: str, mesh: Mesh, jacobian: np.ndarray) -> Prior | np.ndarray:
    made = {"NOSER": lambda: noser(jacobian, 0.5), "Laplace": lambda: laplace(mesh)}
    return made[name]() if name in made else np.ones(jacobian.shape[1])


def check_prior(name: str, mesh: Mesh, jacobian: np.ndarray, values: dict[str, np.ndarray]) -> None:
    """Noise figures to every digit printed, images to 1e-8, matrices (float32) to 1e-6."""
    number, prior = PRIORS.index(name), prior_of(name, mesh, jacobian)
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


@pytest.mark.parametrize("name", PRIORS)
def test_images_and_noise_figures(reference, name):
    jacobian = reference.readings(reference.model.jacobian())
    check_prior(name, reference.model.mesh, jacobian, reference.values)


def test_prior_weights(reference):
    values, mesh = reference.values, reference.model.mesh
    jacobian = reference.readings(reference.model.jacobian())
    assert np.allclose(noser(jacobian, 0.5), values["nosd"].ravel(), rtol=1e-10)
    rows, columns = (values[name].ravel().astype(int) - 1 for name in ("Li", "Lj"))
    count = len(mesh.elements)
    expected = sparse.csc_matrix((values["Lv"].ravel(), (rows, columns)), shape=(count, count))
    assert abs(expected - laplace_matrix(mesh)).max() == 0


@pytest.mark.parametrize("name", PRIORS)
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


@pytest.mark.parametrize("name", PRIORS)
def test_point_electrode_images_and_noise_figures(shared, name):
    """With the Jacobian of the file: what is compared is the reconstruction."""
    with np.load(shared / "oracle" / "pem_c2c0.npz") as file:
        values = dict(file)
    elements = values["elems"].astype(np.int64) - 1
    first, second, third = (values["nodes"][elements[:, k]] for k in range(3))
    turned = np.linalg.det(np.stack([second - first, third - first], axis=1)) < 0
    elements[turned] = elements[turned][:, ::-1]
    check_prior(name, Mesh(values["nodes"], elements), values["J"], values)


def test_the_two_forms_differ_as_published(shared):
    with np.load(shared / "oracle" / "pem_c2c0.npz") as file:
        values = dict(file)
    signal = values["v_tgt"].ravel() - values["v_homog"].ravel()
    matrix = dual_matrix(values["J"], noser(values["J"], 0.5), 0.3)
    assert noise_figure(matrix, signal, values["vol"].ravel()) == pytest.approx(0.494, abs=5e-4)
