"""Linear finite elements on triangles: what depends on geometry alone.

Plain numpy instead of scikit-fem: the stiffness of a linear triangle is one outer product, and keeping it per element
lets the conductance enter as a scale (one ``bincount`` a frame), which a form-compiling library does not offer.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.mesh import Mesh

Matrix = NDArray[np.float64]


def gradients(mesh: Mesh) -> Matrix:
    """Gradients of the three hat functions on each element.

    Returns
    -------
    (e, 3, 2) float64 [1/mm].
    """
    corners = mesh.corners_mm
    opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    turned = np.stack([-opposite[..., 1], opposite[..., 0]], axis=-1)
    gradient: Matrix = turned / (2 * mesh.areas_mm2)[:, None, None]
    return gradient


def local_stiffness(mesh: Mesh) -> Matrix:
    """∫ ∇φ_i·∇φ_j over each element, for unit sheet conductance.

    Returns
    -------
    (e, 3, 3) float64, dimensionless.
    """
    gradient = gradients(mesh)
    return mesh.areas_mm2[:, None, None] * (gradient @ gradient.transpose(0, 2, 1))


def electrode_system(
    mesh: Mesh, conductance: Matrix, contact_impedance: Matrix, *, stiffness: Matrix
) -> sparse.csc_matrix:
    """Matrix of the complete electrode model over node and electrode potentials (Vauhkonen et al. 1999, eq 12).

    The term that fixes ΣU = 0 is added to the electrodes' block: electrode currents sum to zero, so it is not felt by
    the solution, and the matrix becomes symmetric positive definite.

    Parameters
    ----------
    conductance : (e,) [S]. contact_impedance : (electrodes,) [Ω·mm]. stiffness : of :func:`local_stiffness`.

    Returns
    -------
    (n + electrodes, n + electrodes) [S].
    """
    nodes, electrodes = len(mesh.nodes_mm), len(mesh.electrode_edges)
    elements = mesh.elements
    rows = [np.repeat(elements, 3, axis=1).ravel()]
    columns = [np.tile(elements, 3).ravel()]
    values = [(conductance[:, None, None] * stiffness).ravel()]
    for number, edges in enumerate(mesh.electrode_edges):
        row, column, value = _contact(mesh, edges, nodes + number, float(contact_impedance[number]))
        rows.append(row)
        columns.append(column)
        values.append(value)
    block = nodes + np.arange(electrodes)
    rows.append(np.repeat(block, electrodes))
    columns.append(np.tile(block, electrodes))
    values.append(np.full(electrodes**2, float(np.median(conductance))))
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csc_matrix(entries, shape=(nodes + electrodes,) * 2)


def _contact(
    mesh: Mesh, edges: NDArray[np.int64], electrode: int, impedance: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], Matrix]:
    """∫ (u − U)(v − V)/z along one electrode."""
    along = mesh.nodes_mm[edges[:, 1]] - mesh.nodes_mm[edges[:, 0]]
    length = np.hypot(along[:, 0], along[:, 1]) / impedance
    triple = np.column_stack([edges, np.full(len(edges), electrode)])
    unit = np.array([[2, 1, -3], [1, 2, -3], [-3, -3, 6]]) / 6
    values: Matrix = (length[:, None, None] * unit).ravel()
    return np.repeat(triple, 3, axis=1).ravel(), np.tile(triple, 3).ravel(), values


def check_connected(mesh: Mesh) -> None:
    """Refuse a mesh in several pieces, or with nodes that belong to no element.

    Raises
    ------
    NumericsError
        Naming how many pieces there are.
    """
    count = len(mesh.nodes_mm)
    first, second = mesh.elements[:, [0, 1, 2]].ravel(), mesh.elements[:, [1, 2, 0]].ravel()
    graph = sparse.coo_matrix((np.ones(len(first)), (first, second)), shape=(count, count))
    pieces, _ = sparse.csgraph.connected_components(graph, directed=False)
    if pieces != 1:
        raise NumericsError(
            f"the mesh falls into {pieces} pieces that share no edge",
            remedy="use a mesh of one piece without loose nodes",
        )
