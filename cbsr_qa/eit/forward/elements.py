"""Finite elements of first and second order, and electrodes on them: everything that depends on geometry alone.

Matrices stay per element, so that the conductance is a factor and a local change affects only its own elements. Nodes
of a triangle are its corners, then the middles of the edges from corner j to j + 1; those of an edge its ends, then
its middle.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.mesh import Mesh


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Shape functions at an element's integration points, in barycentric coordinates.

    Parameters
    ----------
    points : (q, 3) points inside a triangle, of equal weight.
    slopes : (q, k, 2) derivatives by the second and by the third barycentric coordinate.
    edge_weights : (g,) weights of the points along an edge, with sum 1.
    edge_values, edge_slopes : (g, b) functions of the edge and their derivatives from end to end.
    """

    points: Array
    slopes: Array
    edge_weights: Array
    edge_values: Array
    edge_slopes: Array


def _linear() -> Shapes:
    points = np.full((1, 3), 1 / 3)
    nodes, weights = _gauss(2)
    values = np.column_stack([1 - nodes, nodes])
    return Shapes(points, _free(np.eye(3)[None]), weights, values, np.tile([-1.0, 1.0], (2, 1)))


def _quadratic() -> Shapes:
    """Three points are exact for the stiffness of straight elements, and enough for bent ones (Ciarlet 1978)."""
    points = (np.eye(3) * 3 + 1) / 6
    slopes = np.zeros((3, 6, 3))
    for corner in range(3):
        following = (corner + 1) % 3
        slopes[:, corner, corner] = 4 * points[:, corner] - 1
        slopes[:, 3 + corner, corner] = 4 * points[:, following]
        slopes[:, 3 + corner, following] = 4 * points[:, corner]
    s, weights = _gauss(4)
    values = np.column_stack([(1 - s) * (1 - 2 * s), s * (2 * s - 1), 4 * s * (1 - s)])
    return Shapes(points, _free(slopes), weights, values, np.column_stack([4 * s - 3, 4 * s - 1, 4 - 8 * s]))


def _free(slopes: Array) -> Array:
    return slopes[..., 1:] - slopes[..., :1]


def _gauss(count: int) -> tuple[Array, Array]:
    points, weights = np.polynomial.legendre.leggauss(count)
    return (points + 1) / 2, weights / 2


#: Shapes by the order of the elements.
SHAPES: Final = {1: _linear(), 2: _quadratic()}


class FiniteElements:
    """Continuous functions that are polynomials on each element, with one unknown per node.

    Parameters
    ----------
    mesh : mesh whose nodes come first.
    order : 1, the mesh's triangles; or 2, with the middles of edges as further nodes, following the mesh's arcs
        (isoparametric).

    Raises
    ------
    NumericsError
        If there are no elements of that order, or an arc bends an element inside out.
    """

    def __init__(self, mesh: Mesh, order: int = 1) -> None:
        if order not in SHAPES:
            raise NumericsError(f"element order is {order}; allowed: 1 and 2")
        self.mesh = mesh
        self.order = order
        self.shapes = SHAPES[order]
        #: nodes of each element, (e, 3) or (e, 6) int64
        self.cells: Indices = mesh.elements
        #: places of the nodes, (n, 2) [mm]
        self.points_mm: Array = mesh.nodes_mm
        if order == 2:
            count = len(mesh.nodes_mm)
            self.cells = np.hstack([mesh.elements, count + mesh.element_edges])
            self.points_mm = np.vstack([mesh.nodes_mm, mesh.nodes_mm[mesh.edges].mean(axis=1)])
            for arcs in mesh.arcs:
                self.points_mm[self.along(arcs.edges)[:, 2]] = arcs.middles_mm(mesh.nodes_mm)

    @property
    def count(self) -> int:
        """Number of nodes n."""
        return len(self.points_mm)

    @cached_property
    def elements_per_node(self) -> Indices:
        """Number of elements at each node, (n,) int64."""
        return np.bincount(self.cells.ravel(), minlength=self.count).astype(np.int64)

    @cached_property
    def reaches_mm(self) -> Array:
        """Reach of each element of its mesh, (e,) [mm], see :func:`reaches_mm`."""
        return reaches_mm(self.mesh)

    @property
    def weights_mm2(self) -> Array:
        """Area that each integration point stands for, (e, q) [mm²]."""
        return self._geometry[0]

    @property
    def gradients(self) -> Array:
        """Gradients of the k shape functions at the integration points, (e, q, k, 2) [1/mm]."""
        return self._geometry[1]

    @cached_property
    def stiffness(self) -> Array:
        """∫ ∇φ_i·∇φ_j over each element, for unit sheet conductance: (e, k, k), dimensionless."""
        root = np.sqrt(self.weights_mm2)[..., None, None] * self.gradients
        return _outer(root, root)

    def directional_stiffness(self, elements: Indices, conductance: Array) -> Array:
        """∫ ∇φ_i·Γ∇φ_j over elements (m,) for symmetric Γ (m, q, 2, 2) at the integration points: (m, k, k) [S]."""
        gradients = self.gradients[elements]
        weighted = (self.weights_mm2[elements][..., None, None] * conductance)[:, :, None]
        return _outer((weighted @ gradients[..., None])[..., 0], gradients)

    def along(self, edges: Indices) -> Indices:
        """Nodes along edges of the mesh: (b, 2) pairs of its nodes to (b, 2) or, with the middle, (b, 3).

        NumericsError if no element has such an edge.
        """
        if self.order == 1:
            return edges
        count = len(self.mesh.nodes_mm)
        mesh_keys = self.mesh.edges @ np.array([count, 1])
        edge_keys = np.sort(edges, axis=1) @ np.array([count, 1])
        row = np.minimum(np.searchsorted(mesh_keys, edge_keys), len(mesh_keys) - 1)
        stray_rows = np.flatnonzero(mesh_keys[row] != edge_keys)
        if stray_rows.size:
            first, second = edges[stray_rows[0]]
            raise NumericsError(
                f"nodes {first} and {second} are joined by an arc or an electrode, but by no element's edge",
                remedy="list edges of the mesh only",
            )
        return np.column_stack([edges, count + row]).astype(np.int64)

    def edge_masses(self, edges: Indices) -> Array:
        """∫ φ_i φ_j ds along edges of the mesh, over the nodes of :meth:`along`: (b, 2, 2) or (b, 3, 3) [mm]."""
        shapes = self.shapes
        tangent = shapes.edge_slopes @ self.points_mm[self.along(edges)]  # (b, g, 2)
        lengths = np.hypot(tangent[..., 0], tangent[..., 1]) * shapes.edge_weights
        return (shapes.edge_values.T * lengths[:, None]) @ shapes.edge_values

    @cached_property
    def _geometry(self) -> tuple[Array, Array]:
        slopes = self.shapes.slopes
        q, k = slopes.shape[:2]
        frame = slopes.transpose(0, 2, 1).reshape(2 * q, k) @ self.points_mm[self.cells]
        (ax, ay), (bx, by) = np.moveaxis(frame.reshape(-1, q, 2, 2), (2, 3), (0, 1))  # first and second edge vector
        twice = ax * by - ay * bx
        folded = np.flatnonzero((twice <= 0).any(axis=1))
        if folded.size:
            raise NumericsError(
                f"an arc bends element {folded[0]} (one of {folded.size} such) inside out",
                remedy="use smaller elements along the arc",
            )
        inverse = np.stack([np.stack([by, -bx], -1), np.stack([-ay, ax], -1)], -2) / twice[..., None, None]
        return twice / (2 * q), slopes @ inverse


def reaches_mm(mesh: Mesh) -> Array:
    """Largest distance of a corner of each element from its centroid, (e,) [mm]."""
    away = mesh.corners_mm - mesh.centroids_mm[:, None]
    return np.asarray(np.hypot(away[..., 0], away[..., 1]).max(axis=1), dtype=np.float64)


def _outer(first: Array, second: Array) -> Array:
    count, q, k, _ = first.shape
    flat = (part.transpose(0, 2, 1, 3).reshape(count, k, 2 * q) for part in (first, second))
    first_flat, second_flat = flat
    return first_flat @ second_flat.swapaxes(1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """Electrodes in terms of nodes.

    Parameters
    ----------
    means : (n, electrodes) weights of the mean potential under each electrode; columns sum to one.
    lengths_mm : (electrodes,) ∞ for points, which have no contact impedance.
    nodes : nodes (b,) that each electrode touches.
    masses : matrix (b, b) of each electrode, ∫ (u − ū)(v − v̄) ds over those nodes [mm]; zero for points.
    """

    means: Array
    lengths_mm: Array
    nodes: tuple[Indices, ...]
    masses: tuple[Array, ...]


def edge_contacts(elements: FiniteElements) -> Contacts:
    """Electrodes along the mesh's electrode edges; NumericsError for one without edges, or edges without element."""
    electrodes = elements.mesh.electrode_edges
    edgeless = [k for k, edges in enumerate(electrodes) if not len(edges)]
    if edgeless or not electrodes:
        raise NumericsError(
            f"the mesh carries {len(electrodes) - len(edgeless)} electrodes with edges",
            remedy=f"give edges to electrode {edgeless[0]}" if edgeless else "use a mesh that carries electrodes",
        )
    means = np.zeros((elements.count, len(electrodes)))
    lengths, nodes, masses = np.zeros(len(electrodes)), [], []
    for number, edges in enumerate(electrodes):
        touched_nodes, local = np.unique(elements.along(edges), return_inverse=True)
        local = local.reshape(len(edges), -1)
        mass = np.zeros((len(touched_nodes), len(touched_nodes)))
        np.add.at(mass, (local[:, :, None], local[:, None, :]), elements.edge_masses(edges))
        node_lengths = mass.sum(axis=1)
        lengths[number] = node_lengths.sum()
        means[touched_nodes, number] = node_lengths / lengths[number]
        nodes.append(touched_nodes.astype(np.int64))
        masses.append(mass - np.outer(node_lengths, node_lengths) / lengths[number])
    return Contacts(means, lengths, tuple(nodes), tuple(masses))


def point_contacts(elements: FiniteElements, nodes: Indices) -> Contacts:
    """Electrodes that are single nodes (electrodes,); NumericsError if one is not in the mesh, or carries two."""
    nodes = np.asarray(nodes, dtype=np.int64)
    count = len(elements.mesh.nodes_mm)
    if nodes.ndim != 1 or not nodes.size or not 0 <= nodes.min() <= nodes.max() < count:
        raise NumericsError(f"point electrodes are a list of nodes from 0 to {count - 1}, one for each electrode")
    if len(np.unique(nodes)) != len(nodes):
        raise NumericsError("two point electrodes are at the same node", remedy="give each its own node")
    means = np.zeros((elements.count, len(nodes)))
    means[nodes, np.arange(len(nodes))] = 1
    none = tuple(np.zeros((1, 1)) for _ in nodes)
    return Contacts(means, np.full(len(nodes), np.inf), tuple(nodes[:, None]), none)
