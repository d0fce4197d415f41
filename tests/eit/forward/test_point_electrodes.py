"""Point electrodes: same mesh in, same numbers out as EIDORS on Octave."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from cbsr_qa.domain.sensor import Mesh, adjacent_pattern
from cbsr_qa.eit.forward.model import ForwardModel, point_model
from cbsr_qa.eit.inverse import dual_matrix, noser


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


@pytest.fixture(scope="module")
def points(shared: Path) -> Reference:
    with np.load(shared / "oracle" / "pem_c2c0.npz") as file:
        values = dict(file)
    elements = values["elems"].astype(np.int64) - 1
    first, second, third = (values["nodes"][elements[:, k]] for k in range(3))
    turned = np.linalg.det(np.stack([second - first, third - first], axis=1)) < 0
    elements[turned] = elements[turned][:, ::-1]
    nodes = values["eln"].ravel().astype(np.int64) - 1
    model = point_model(Mesh(values["nodes"], elements), nodes, adjacent_pattern(16), np.ones(len(elements)))
    return Reference(model, values)


@pytest.fixture(params=["homogeneous", "uneven"])
def conductance(request, points) -> tuple[np.ndarray, str, str]:
    if request.param == "uneven":
        return points.values["sig"].ravel(), "v_inhomog", "Ji"
    return np.ones(576), "v_homog", "J"


def test_voltages(points, conductance):
    values, name, _ = conductance
    found = points.readings(points.model.changed(conductance=values).voltages())
    expected = points.values[name].ravel()
    assert np.abs(found - expected).max() < 1e-10 * np.abs(expected).max()


def test_potentials_of_all_nodes(points):
    """EIDORS grounds one node; ours are the same up to a constant in each column."""
    currents = points.values["stim"]
    found = points.model.electrode_fields @ currents
    expected = points.values["volt_homog"]
    assert np.abs(found - found[:1] - expected + expected[:1]).max() < 1e-10 * np.abs(expected).max()


def test_jacobian(points, conductance):
    values, _, name = conductance
    found = points.readings(points.model.changed(conductance=values).jacobian())
    assert np.abs(found - points.values[name]).max() < 1e-8 * np.abs(points.values[name]).max()


def test_reconstructions(points):
    values = points.values
    jacobian = points.readings(points.model.jacobian())
    change = values["v_inhomog"].ravel() - values["v_homog"].ravel()
    matrix = dual_matrix(jacobian, noser(jacobian, 0.5), values["hps"].ravel()[0])
    assert np.abs(matrix - values["RMn"][:, :, 0]).max() < 1e-6 * np.abs(values["RMn"][:, :, 0]).max()
    assert np.abs(matrix @ change - values["rec"][:, 0]).max() < 1e-8 * np.abs(values["rec"][:, 0]).max()


def test_system_matrix(points):
    values, model = points.values, points.model
    rows, columns = (values[name].ravel().astype(int) - 1 for name in ("Si", "Sj"))
    expected, found = np.zeros((313, 313)), np.zeros((313, 313))
    np.add.at(expected, (rows, columns), values["Sv"].ravel())
    cells = model.elements.cells
    np.add.at(found, (cells[:, :, None], cells[:, None, :]), model.stiffness)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def test_there_is_no_contact_impedance(points):
    other = points.model.changed(contact_impedance=np.full(16, 1e3))
    assert np.array_equal(other.voltages(), points.model.voltages())
    assert not points.model.contact_jacobian().any()
