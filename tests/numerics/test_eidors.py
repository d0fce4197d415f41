"""Same mesh in, same numbers out as EIDORS on Octave."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.patterns import adjacent_pattern
from cbsr_qa.forward.model import ForwardModel
from cbsr_qa.reconstruct.choice import hyperparameter_for
from cbsr_qa.reconstruct.dual import dual_matrix, dual_spectrum
from cbsr_qa.reconstruct.noise_figure import NoiseFigureForm, noise_figure
from cbsr_qa.reconstruct.priors import noser

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


def test_noser_images_and_noise_figures(reference):
    values = reference.values
    jacobian = reference.readings(reference.model.jacobian())
    prior = noser(jacobian, 0.5)
    assert np.allclose(prior, values["nosd"].ravel(), rtol=1e-10)
    homogeneous = values["v_homog"].ravel()
    change, signal = values["v_inhomog"].ravel() - homogeneous, values["v_tgt"].ravel() - homogeneous
    areas = reference.model.mesh.areas_mm2
    for hyperparameter, expected in zip(values["hps"].ravel(), values["NF"][0], strict=True):
        matrix = dual_matrix(jacobian, prior, hyperparameter)
        eidors = noise_figure(matrix, signal, areas, form=NoiseFigureForm.EIDORS)
        assert eidors == pytest.approx(expected, rel=1e-8)
        assert 1.02 < noise_figure(matrix, signal, areas) / eidors < 1.2
    image = dual_matrix(jacobian, prior, values["hps"].ravel()[0]) @ change
    expected_image = values["rec"][:, 0]
    assert np.abs(image - expected_image).max() < 1e-8 * np.abs(expected_image).max()


def test_hyperparameter_for_noise_figure_one(reference):
    """EIDORS finds it by a coarse search and for its own form; ours lies within the spread of the two forms."""
    values = reference.values
    jacobian = reference.readings(reference.model.jacobian())
    spectrum = dual_spectrum(jacobian, noser(jacobian, 0.5))
    signal = values["v_tgt"].ravel() - values["v_homog"].ravel()
    found = hyperparameter_for(1.0, spectrum, signal, reference.model.mesh.areas_mm2)
    assert 1.0 < found / values["hpNF1"].ravel()[0] < 1.05


def test_point_electrode_noise_figures(shared):
    with np.load(shared / "oracle" / "pem_c2c0.npz") as file:
        values = dict(file)
    jacobian, areas = values["J"], values["vol"].ravel()
    signal = values["v_tgt"].ravel() - values["v_homog"].ravel()
    for hyperparameter, expected in zip(values["hps"].ravel(), values["NF"][0], strict=True):
        matrix = dual_matrix(jacobian, noser(jacobian, 0.5), hyperparameter)
        assert noise_figure(matrix, signal, areas, form=NoiseFigureForm.EIDORS) == pytest.approx(expected, rel=1e-10)
    matrix = dual_matrix(jacobian, noser(jacobian, 0.5), 0.3)
    assert noise_figure(matrix, signal, areas) == pytest.approx(0.494, abs=5e-4)
