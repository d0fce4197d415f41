"""Prepared system of equations of a sheet: a new conductance only scales, factorises and solves it.

The matrix is linear in the elements' conductance and in the reciprocal contact impedance. If potentials are refined,
residuals are computed without the diagonal, as Σ_j K_ij (u_j − u_i), from potentials in twice the precision (Dekker
1971): with contrasts of 1e8, rounding of the diagonal would cost readings half their digits. Corrections from the
same factors are added until they are as small as rounding (Wilkinson 1963; Demmel et al. 2006).
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any, Final

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.forward.elements import Contacts, FiniteElements

_MAX_STEPS: Final = 12
_CONVERGED_SHARE: Final = 1e-13  # of the largest potential: the next correction would be rounding
_MIN_SHRINKING: Final = 0.5  # a correction not smaller than this share of the last one is rounding
_FAILED_SHARE: Final = 1e-2  # of the largest potential: corrections that end above it have failed


def refine(
    conductors: sparse.csc_matrix, load: Array, solve: Callable[[Array], Array], potentials: Array, ground: int
) -> tuple[Array, Array]:
    """Refine potentials until they are those of the conductors to rounding.

    Parameters
    ----------
    conductors : symmetric, rows sum to zero; its diagonal is ignored, and no column is empty.
    load : (n, k) currents into the nodes, columns that sum to zero [A].
    solve : approximate potentials of a load.
    potentials : (n, k) initial [V].
    ground : reference node of the returned potentials.

    Returns
    -------
    (n, k) and (n, k) [V], rounded potentials and their rounding errors.

    Raises
    ------
    NumericsError
        If corrections do not shrink: the factors have no accurate digit.
    """
    high, low = potentials - potentials[ground], np.zeros_like(potentials)
    change_share = np.inf
    for _ in range(_MAX_STEPS):
        correction = solve(load - _compute_currents_out(conductors, high, low))
        correction -= correction[ground]
        high, rounding_error = _sum(high, correction)
        high, low = _sum(high, low + rounding_error)
        largest, largest_change = np.abs(high).max(axis=0), np.abs(correction).max(axis=0)
        shares = largest_change[largest > 0] / largest[largest > 0]
        previous_share, change_share = change_share, float(shares.max(initial=0.0))
        if change_share <= _CONVERGED_SHARE or change_share > _MIN_SHRINKING * previous_share:
            break
    if not change_share <= _FAILED_SHARE:
        raise NumericsError(
            "the sheet's potentials cannot be refined: conductances and contact impedances span too wide a range",
            remedy="bring conductances and contact impedances closer to each other",
        )
    return high, low


def _compute_currents_out(conductors: sparse.csc_matrix, high: Array, low: Array) -> Array:
    """Current out of each node into the others for potentials high + low, (n, k) [V] both: (n, k) [A]."""
    row, counts = conductors.indices, np.diff(conductors.indptr)
    difference, rounding_error = _sum(high[row], -np.repeat(high, counts, axis=0))
    rounding_error += low[row] - np.repeat(low, counts, axis=0)
    flow = conductors.data[:, None] * (difference + rounding_error)
    return np.asarray(np.add.reduceat(flow, conductors.indptr[:-1], axis=0), dtype=np.float64)


def _sum(a: Array, b: Array) -> tuple[Array, Array]:
    """Rounded sum, and its rounding error (Knuth)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


# Supernodes are not relaxed: with the symmetric ordering SuperLU pads some until they cost ten times as much.
_SYMMETRIC: Final[dict[str, Any]] = {
    "diag_pivot_thresh": 0.0,
    "relax": 1,
    "panel_size": 1,
    "options": {"SymmetricMode": True, "Equil": False},
}


class PreparedSheet:
    """Complete electrode model over the nodes (Vauhkonen et al. 1999, eq 12).

    The electrodes' potentials are eliminated, U_l = z_l I_l/|E_l| + mean of u on E_l: poor contacts cost no digits of
    readings that they do not affect. The free constant is fixed at one node of the best conductor.

    NumericsError if the mesh is in pieces, or has nodes that belong to no element.
    """

    def __init__(self, elements: FiniteElements, contacts: Contacts) -> None:
        check_connected(elements.mesh)
        self.elements = elements
        self.contacts = contacts
        rows, columns, owner, values = _entries(elements, contacts)
        sources = len(elements.cells) + len(contacts.nodes)
        fixed_node = elements.cells[0, 0]  # arbitrary values: only the pattern of entries matters
        places = np.append(rows, fixed_node), np.append(columns, fixed_node)
        matrix = sparse.csc_matrix((np.append(values, 1.0), places), shape=(elements.count,) * 2)
        #: place of each node in the order of elimination, (n,)
        self.place: Indices = splu(matrix, permc_spec="MMD_AT_PLUS_A", **_SYMMETRIC).perm_c.astype(np.int64)
        keys = self.place[columns] * elements.count + self.place[rows]
        entry, slot = np.unique(keys, return_inverse=True)
        column, self._row = np.divmod(entry, elements.count)
        self._start = np.searchsorted(column, np.arange(elements.count + 1)).astype(np.int32)
        self._row = self._row.astype(np.int32)
        self._diagonal = np.flatnonzero(self._row == column)
        k = elements.cells.shape[1]
        self._slot = slot[: elements.cells.size * k].reshape(len(elements.cells), k, k)
        self._scale = sparse.csr_matrix((values, (slot, owner)), shape=(len(entry), sources))

    @cached_property
    def ordered_drives(self) -> Array:
        """Unit currents into each electrode but the first, returned evenly by all, in the order of elimination."""
        means = self.contacts.means[np.argsort(self.place)]
        return np.asfortranarray((means - means.mean(axis=1, keepdims=True))[:, 1:])

    @cached_property
    def beside(self) -> tuple[Indices, ...]:
        """Elements that touch each electrode."""
        cells = self.elements.cells
        touching = []
        for nodes in self.contacts.nodes:
            is_touched = np.zeros(self.elements.count, dtype=np.bool_)
            is_touched[nodes] = True
            touching.append(np.flatnonzero(is_touched[cells].any(axis=1)))
        return tuple(touching)

    def factorise(self, conductance: Array, contact_impedance: Array) -> "Factors":
        """Scale and factorise the matrix for (e,) or (e, q, 2, 2) [S] and (electrodes,) [Ω·mm]."""
        even, uneven = _split(conductance)
        values = self._scale @ np.concatenate([even, 1 / contact_impedance])
        if uneven.size:
            directional = conductance[uneven] - even[uneven, None, None, None] * np.eye(2)
            change = self.elements.directional_stiffness(uneven, directional)
            values += np.bincount(self._slot[uneven].ravel(), change.ravel(), minlength=len(values))
        shape = (self.elements.count,) * 2
        conductors = sparse.csc_matrix((values.copy(), self._row, self._start), shape=shape)
        best = int(even.argmax())
        ground = int(self.place[self.elements.cells[best, 0]])
        values[self._diagonal[ground]] += even[best]
        matrix = sparse.csc_matrix((values, self._row, self._start), shape=shape)
        factors = splu(matrix, permc_spec="NATURAL", **_SYMMETRIC)
        return Factors(factors, self.place, conductors, ground, float(even[best]))


class Factors:
    """A factorised matrix.

    Parameters
    ----------
    factors : LU factors in the order of elimination, with one node fixed.
    place : (n,) each node's place in that order.
    conductors : the matrix without the term that fixes the node.
    ground : place of the fixed node. held_by : conductance that fixes it [S].
    """

    def __init__(
        self, factors: SuperLU, place: Indices, conductors: sparse.csc_matrix, ground: int, held_by: float
    ) -> None:
        self._factors = factors
        self._place = place
        self._conductors = conductors
        self._ground = ground
        self._held_by = held_by
        self._order = np.argsort(place)

    def solve(self, load: Array, *, refine: bool = False) -> Array:
        """Potentials for currents into nodes: (n, k) [A] to (n, k) [V]; refined as in :meth:`refine_ordered`."""
        ordered = np.take(load.T, self._order, axis=1).T  # column-major, as the solver requires
        return (self.refine_ordered(ordered)[0] if refine else self.solve_ordered(ordered))[self._place]

    def solve_ordered(self, load: Array) -> Array:
        """The same, both in the order of elimination."""
        return self._factors.solve(load)

    def refine_ordered(self, load: Array) -> tuple[Array, Array]:
        """The same to rounding for any values, and the rounding error; see :func:`refine`."""
        total = load.sum(axis=0)
        balanced = load.copy()
        balanced[self._ground] -= total
        high, low = refine(self._conductors, balanced, self.solve_ordered, self.solve_ordered(balanced), self._ground)
        high += total / self._held_by
        return high, low


def check_connected(mesh: Mesh) -> None:
    """Refuse a mesh in several pieces, or with nodes that belong to no element; NumericsError counts the pieces."""
    count = len(mesh.nodes_mm)
    first, second = mesh.elements[:, [0, 1, 2]].ravel(), mesh.elements[:, [1, 2, 0]].ravel()
    graph = sparse.coo_matrix((np.ones(len(first)), (first, second)), shape=(count, count))
    pieces, _ = sparse.csgraph.connected_components(graph, directed=False)
    if pieces != 1:
        raise NumericsError(
            f"the mesh falls into {pieces} pieces that share no edge",
            remedy="use a mesh of one piece without loose nodes",
        )


def _entries(elements: FiniteElements, contacts: Contacts) -> tuple[Indices, Indices, Indices, Array]:
    """Rows, columns, sources and values of all entries; a source is an element or, after them, an electrode."""
    cells, count = elements.cells, len(elements.cells)
    k = cells.shape[1]
    rows, columns = [np.repeat(cells, k, axis=1).ravel()], [np.tile(cells, k).ravel()]
    owner, values = [np.repeat(np.arange(count), k * k)], [elements.stiffness.ravel()]
    for number, (nodes, mass) in enumerate(zip(contacts.nodes, contacts.masses, strict=True)):
        rows.append(np.repeat(nodes, len(nodes)))
        columns.append(np.tile(nodes, len(nodes)))
        owner.append(np.full(mass.size, count + number))
        values.append(mass.ravel())
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(owner), np.concatenate(values)


def _split(conductance: Array) -> tuple[Array, Indices]:
    """A conductance for each element, and the elements for which it is not sufficient."""
    if conductance.ndim == 1:
        return conductance, np.zeros(0, dtype=np.int64)
    even = conductance[:, 0, 0, 0]
    alike = (conductance == even[:, None, None, None] * np.eye(2)).all(axis=(1, 2, 3))
    return even, np.flatnonzero(~alike)
