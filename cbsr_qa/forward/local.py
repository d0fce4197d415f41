"""Exact voltages after local changes of conductance, without factorising again.

A change on elements E with nodes P alters the system by P ΔK Pᵀ, where ΔK is small and dense. With F the fields
of the electrodes on P and W = Pᵀ K⁻¹ P, the transfer impedance changes by −Fᵀ (I + ΔK W)⁻¹ ΔK F (Woodbury; Hager
1989). It is an identity, not an approximation. W does not depend on the change, so each further change on the same
elements is one dense solve of the size of P.
"""

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.forward.model import ForwardModel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_KEPT = 64  # sets of elements whose dense parts are kept


@dataclass(frozen=True, slots=True, eq=False)
class _Patch:
    """What a set of elements needs, whatever its change: p nodes, k elements."""

    scatter: Indices  # (9 k,) which stored entry of the sparse (p, p) ΔK each local stiffness entry adds to
    columns: Indices  # of the stored entries
    rows: Indices  # (p + 1,) where each row's entries begin
    stiffness: Array  # (k, 9)
    fields: Array  # (p, electrodes) F
    interior: Array  # (p, p) W


class LocalUpdate:
    """Voltages of a model whose conductance changes on a few elements at a time.

    Parameters
    ----------
    model : the unchanged sheet; its factorisation is used for every new node, once.
    """

    def __init__(self, model: ForwardModel) -> None:
        self.model = model
        self._unchanged = model.voltages()
        self._column_of = np.full(len(model.mesh.nodes_mm), -1, dtype=np.int64)
        self._columns: Array = np.empty((0, len(model.mesh.nodes_mm)))
        self._patches: OrderedDict[bytes, _Patch] = OrderedDict()

    def voltages(self, elements: Indices, conductance_change: Array) -> Array:
        """Readings after the conductance of some elements has changed.

        Parameters
        ----------
        elements : (k,) int64; changes of an element named twice add up.
        conductance_change : (k,) [S] against the model's conductance.

        Returns
        -------
        (drives, measures) float64 [V per A].

        Raises
        ------
        NumericsError
            If an element is not in the mesh, or its new conductance is not a positive finite number.
        """
        elements, change = self._checked(elements, conductance_change)
        if not elements.size:
            return self._unchanged.copy()
        patch = self._patch(elements)
        nodes = len(patch.fields)
        entries = np.bincount(patch.scatter, (change[:, None] * patch.stiffness).ravel())
        stiffness = sparse.csr_array((entries, patch.columns, patch.rows), shape=(nodes, nodes))
        capacitance = np.asarray(stiffness @ patch.interior)
        capacitance.flat[:: nodes + 1] += 1
        correction = patch.fields.T @ np.linalg.solve(capacitance, np.asarray(stiffness @ patch.fields))
        return self._unchanged - self.model.readings(correction)

    def _checked(self, elements: Indices, change: Array) -> tuple[Indices, Array]:
        elements, change = np.asarray(elements, dtype=np.int64), np.asarray(change, dtype=np.float64)
        count = len(self.model.mesh.elements)
        if elements.ndim != 1 or change.shape != elements.shape:
            raise NumericsError(f"{change.shape} conductance changes do not fit {elements.shape} elements")
        if elements.size and not 0 <= elements.min() <= elements.max() < count:
            raise NumericsError(f"a changed element is not one of 0 to {count - 1}")
        unique, place = np.unique(elements, return_inverse=True)
        total: Array = np.bincount(place, change, minlength=len(unique)).astype(np.float64)
        new = self.model.conductance[unique] + total
        wrong = np.flatnonzero(~(np.isfinite(new) & (new > 0)))
        if wrong.size:
            raise NumericsError(
                f"the change of element {unique[wrong[0]]} leaves it with a conductance of {new[wrong[0]]} S;"
                " it must stay a positive finite number"
            )
        return unique.astype(np.int64), total

    def _patch(self, elements: Indices) -> _Patch:
        key = elements.tobytes()
        patch = self._patches.get(key)
        if patch is None:
            patch = self._patches[key] = self._new_patch(elements)
            if len(self._patches) > _KEPT:
                self._patches.popitem(last=False)
        self._patches.move_to_end(key)
        return patch

    def _new_patch(self, elements: Indices) -> _Patch:
        nodes, local = np.unique(self.model.mesh.elements[elements], return_inverse=True)
        local = local.reshape(-1, 3)
        place = (local[:, :, None] * len(nodes) + local[:, None, :]).ravel()
        stored, scatter = np.unique(place, return_inverse=True)
        row, columns = np.divmod(stored, len(nodes))
        rows = np.searchsorted(row, np.arange(len(nodes) + 1))
        stiffness = self.model.stiffness[elements].reshape(-1, 9)
        interior = self._solved(nodes)[:, nodes]
        return _Patch(scatter, columns, rows, stiffness, self.model.electrode_fields[nodes], interior)

    def _solved(self, nodes: Indices) -> Array:
        """Rows of K⁻¹ at some nodes, (p, n); each is solved for once."""
        missing = nodes[self._column_of[nodes] < 0]
        if missing.size:
            load = np.zeros((len(self._column_of), missing.size))
            load[missing, np.arange(missing.size)] = 1
            rows = self.model.solve(load).T
            self._column_of[missing] = len(self._columns) + np.arange(missing.size)
            self._columns = np.vstack([self._columns, rows])
        return self._columns[self._column_of[nodes]]
