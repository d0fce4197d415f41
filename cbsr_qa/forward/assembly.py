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


def contact_lengths(mesh: Mesh) -> Matrix:
    """∫ φ_i ds along each electrode: its length, shared out among its nodes.

    Returns
    -------
    (n, electrodes) float64 [mm].
    """
    lengths = np.zeros((len(mesh.nodes_mm), len(mesh.electrode_edges)))
    for number, edges in enumerate(mesh.electrode_edges):
        np.add.at(lengths[:, number], edges, _lengths(mesh, edges)[:, None] / 2)
    return lengths


def electrode_system(
    mesh: Mesh, conductance: Matrix, contact_impedance: Matrix, *, stiffness: Matrix
) -> sparse.csc_matrix:
    """Matrix of the complete electrode model over the nodes (Vauhkonen et al. 1999, eq 12).

    Departs from the usual form in that the electrodes' potentials are eliminated, U_l = z_l I_l/|E_l| + mean of u on
    E_l: contacts of 1e8 Ω·mm then cost no digits of the readings that do not feel them. The free constant is fixed at
    one node; currents sum to zero, so that the solution does not feel how.

    Parameters
    ----------
    conductance : (e,) [S].
    contact_impedance : (electrodes,) [Ω·mm].
    stiffness : of :func:`local_stiffness`.

    Returns
    -------
    (n, n) symmetric positive definite [S].
    """
    rows = [np.repeat(mesh.elements, 3, axis=1).ravel()]
    columns = [np.tile(mesh.elements, 3).ravel()]
    values = [(conductance[:, None, None] * stiffness).ravel()]
    for edges, impedance in zip(mesh.electrode_edges, contact_impedance, strict=True):
        nodes, contact = _contact(mesh, edges)
        rows.append(np.repeat(nodes, len(nodes)))
        columns.append(np.tile(nodes, len(nodes)))
        values.append(contact.ravel() / impedance)
    rows.append(mesh.elements[:1, 0])
    columns.append(mesh.elements[:1, 0])
    values.append(conductance[:1])
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csc_matrix(entries, shape=(len(mesh.nodes_mm),) * 2)


def _contact(mesh: Mesh, edges: NDArray[np.int64]) -> tuple[NDArray[np.int64], Matrix]:
    """∫ (u − ū)(v − v̄) ds along one electrode: its nodes (k,) and the matrix over them (k, k) [mm]."""
    nodes, local = np.unique(edges, return_inverse=True)
    local, length = local.reshape(-1, 2), _lengths(mesh, edges)
    mass = np.zeros((len(nodes), len(nodes)))
    for row, column, share in ((0, 0, 2), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        np.add.at(mass, (local[:, row], local[:, column]), share * length / 6)
    share_of = mass.sum(axis=1)
    return nodes, mass - np.outer(share_of, share_of) / share_of.sum()


def _lengths(mesh: Mesh, edges: NDArray[np.int64]) -> Matrix:
    along = mesh.nodes_mm[edges[:, 1]] - mesh.nodes_mm[edges[:, 0]]
    lengths: Matrix = np.hypot(along[:, 0], along[:, 1])
    return lengths


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
