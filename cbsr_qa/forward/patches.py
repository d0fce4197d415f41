"""Patches of changed elements, seen from their rims: what they need, whatever their change."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from cbsr_qa.forward.inverse import InverseEntries
from cbsr_qa.forward.model import ForwardModel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class Patch:
    """Elements that hang together; those inside are condensed away.

    Parameters
    ----------
    model : the unchanged sheet.
    elements : (k,) int64, each once.
    """

    def __init__(self, model: ForwardModel, elements: Indices) -> None:
        nodes, corner = np.unique(model.mesh.elements[elements], return_inverse=True)
        corner = corner.reshape(-1, 3)
        rim = _seen_outside(model, nodes, corner)
        order = np.argsort(~rim, kind="stable")  # the rim first
        rank = np.argsort(order)[corner]
        self._count = len(nodes)
        self._entry, self._scatter = np.unique(
            (rank[:, :, None] * len(nodes) + rank[:, None, :]).ravel(), return_inverse=True
        )
        row, self._column = np.divmod(self._entry, len(nodes))
        self._rows = np.searchsorted(row, np.arange(len(nodes) + 1))
        self._stiffness = model.stiffness[elements].reshape(-1, 9)
        self._conductance = model.conductance[elements]
        #: nodes that the world outside sees, (b,)
        self.rim: Indices = nodes[rim].astype(np.int64)
        self._extension = np.vstack([np.eye(len(self.rim)), self._inside(self._conductance)])

    @property
    def nbytes(self) -> int:
        """Memory it takes."""
        return _nbytes(self)

    def rim_change(self, change: Array) -> Array:
        """How the stiffness that the rim feels changes, ΔΛ = Eᵀ ΔK E₀: (b, b) [S].

        Parameters
        ----------
        change : (k,) [S] of each element's conductance, leaving it positive.
        """
        shape = self._count, self._count
        stiffness = sparse.csr_array((self._entries(change), self._column, self._rows), shape=shape)
        currents = np.asarray(stiffness @ self._extension)
        b = len(self.rim)
        seen: Array = currents[:b] + self._inside(self._conductance + change).T @ currents[b:]
        return seen

    def _inside(self, conductance: Array) -> Array:
        """Potentials inside for each unit potential of a rim node: (p − b, b)."""
        stiffness = np.zeros(self._count * self._count)
        stiffness[self._entry] = self._entries(conductance)
        b = len(self.rim)
        lower = stiffness.reshape(self._count, self._count)[b:]
        return np.asarray(-np.linalg.solve(lower[:, b:], lower[:, :b]), dtype=np.float64)

    def _entries(self, conductance: Array) -> Array:
        """Entries of the patch's own stiffness matrix that are stored."""
        entries = np.bincount(self._scatter, (conductance[:, None] * self._stiffness).ravel())
        return np.asarray(entries, dtype=np.float64)


class Patches:
    """A set of changed elements as patches that share no node, and what links their rims.

    Parameters
    ----------
    model : the unchanged sheet.
    elements : (k,) int64, each once.
    inverse : gives K₀⁻¹ between rim nodes.
    """

    def __init__(self, model: ForwardModel, elements: Indices, inverse: InverseEntries) -> None:
        self._members = list(_connected(model.mesh.elements[elements]))
        self._patches = [Patch(model, elements[members]) for members in self._members]
        rim = np.concatenate([patch.rim for patch in self._patches])
        ends = np.cumsum([len(patch.rim) for patch in self._patches])
        self._slices = [slice(end - len(p.rim), end) for p, end in zip(self._patches, ends, strict=True)]
        fields = model.electrode_fields[rim]
        self._fields = fields
        self._linked = np.hstack([inverse.between(rim), fields])  # both meet the same change

    @property
    def nbytes(self) -> int:
        """Memory it takes."""
        indices = sum(members.nbytes for members in self._members)
        return indices + _nbytes(self) + sum(patch.nbytes for patch in self._patches)

    def correction(self, change: Array) -> Array:
        """What the transfer impedance loses.

        Parameters
        ----------
        change : (k,) [S] of each element's conductance, leaving it positive.

        Returns
        -------
        (electrodes, electrodes) float64 [V/A].
        """
        changed = np.empty_like(self._linked)
        for patch, members, rows in zip(self._patches, self._members, self._slices, strict=True):
            np.matmul(patch.rim_change(change[members]), self._linked[rows], out=changed[rows])
        count = len(changed)
        capacitance, sources = changed[:, :count], changed[:, count:]
        np.einsum("ii->i", capacitance)[:] += 1
        correction: Array = self._fields.T @ np.linalg.solve(capacitance, sources)
        return correction


def _nbytes(of: object) -> int:
    return sum(value.nbytes for value in vars(of).values() if isinstance(value, np.ndarray))


def _seen_outside(model: ForwardModel, nodes: Indices, corner: Indices) -> NDArray[np.bool_]:
    """Whether a node belongs to an element that does not change, or to an electrode."""
    everywhere = np.bincount(model.mesh.elements.ravel(), minlength=len(model.mesh.nodes_mm))[nodes]
    electrodes = np.concatenate([edges.ravel() for edges in model.mesh.electrode_edges])
    seen: NDArray[np.bool_] = (np.bincount(corner.ravel()) < everywhere) | np.isin(nodes, electrodes)
    return seen


def _connected(corners: Indices) -> Iterator[Indices]:
    """Indices of the elements of each patch."""
    nodes, local = np.unique(corners, return_inverse=True)
    local = local.reshape(-1, 3)
    pairs = local[:, :2].ravel(), local[:, 1:].ravel()
    graph = sparse.coo_array((np.ones(len(pairs[0])), pairs), shape=(len(nodes), len(nodes)))
    count, patch = connected_components(graph, directed=False)
    for number in range(count):
        yield np.flatnonzero(patch[local[:, 0]] == number)
