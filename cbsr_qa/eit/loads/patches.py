"""Patches of changed elements as seen from their rims, independent of the size of the change."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.forward.value_range import conducts
from cbsr_qa.eit.loads.rims import (
    InverseEntries,
    couple,
    find_outer_nodes,
    spans_of,
    split_patches,
)

# Outside fields are smooth at a patch: of the possible fields at its rim, only few occur.
_NEGLIGIBLE: Final = 1e-14
_NEGLIGIBLE_CONTACT: Final = 1e-12  # contacts are round and small: omitted fields have no effect back


class Sized:
    """Counts the memory of its arrays."""

    @property
    def nbytes(self) -> int:
        """Memory of its arrays [bytes]."""
        return sum(value.nbytes for value in vars(self).values() if isinstance(value, np.ndarray))


class PatchStack(Sized):
    """Connected patches of about equal size, with condensed inner nodes.

    All arrays are filled up to the largest patch: with zeros on the rim, and with ones on the diagonal inside.

    Parameters
    ----------
    patches : elements of each, (k,) int64, each once.
    rims : whether a node is coupled to the outside, for the sorted nodes of each patch.
    """

    def __init__(self, model: ForwardModel, patches: Sequence[Indices], rims: Sequence[Mask]) -> None:
        self._rim = max(int(rim.sum()) for rim in rims)
        size = self._rim + max(int((~rim).sum()) for rim in rims)
        cells = model.elements.cells
        #: nodes on the rim of each patch, padded with −1: (g, b)
        self.rims: Indices = np.full((len(patches), self._rim), -1, dtype=np.int64)
        filled = np.tile(np.arange(size) >= self._rim, (len(patches), 1))
        scatter = []
        for number, (elements, rim) in enumerate(zip(patches, rims, strict=True)):
            nodes, corner = np.unique(cells[elements], return_inverse=True)
            rank = np.where(rim, np.cumsum(rim) - 1, self._rim + np.cumsum(~rim) - 1)
            filled[number, rank] = False
            self.rims[number, : rim.sum()] = nodes[rim]
            place = rank[corner.reshape(len(elements), -1)]
            scatter.append((number * size + place[:, :, None]) * size + place[:, None, :])
        self._shape = len(patches), size, size
        self._scatter = np.concatenate(scatter).ravel()
        base = self._assemble(model.element_matrices(np.concatenate(patches)))
        stack, node = np.nonzero(filled)
        base[stack, node, node] = 1
        self._base = np.ascontiguousarray(base[:, self._rim :])
        eye = np.tile(np.eye(self._rim), (len(patches), 1, 1))
        self._extension = np.concatenate([eye, -self._inside(self._base)], axis=1)

    def rim_changes(self, change: Array) -> Array:
        """Change of the stiffness at each rim, ΔΛ = Eᵀ ΔK E₀: (g, b, b) [S].

        Parameters
        ----------
        change : (all elements of the stack, k, k) change of their matrices [S].
        """
        stiffness = self._assemble(change)
        currents = stiffness @ self._extension
        inverse_inside = self._inside(self._base + stiffness[:, self._rim :])
        rim_change: Array = currents[:, : self._rim] - inverse_inside.swapaxes(1, 2) @ currents[:, self._rim :]
        return rim_change

    def _inside(self, lower: Array) -> Array:
        """Minus the potentials inside for each unit potential of a rim node: (g, i, b)."""
        return np.asarray(np.linalg.solve(lower[..., self._rim :], lower[..., : self._rim]), dtype=np.float64)

    def _assemble(self, matrices: Array) -> Array:
        size = self._shape[0] * self._shape[1] * self._shape[2]
        assembled = np.bincount(self._scatter, matrices.ravel(), minlength=size)
        return np.asarray(assembled.reshape(self._shape), dtype=np.float64)


class ContactStack(Sized):
    """The electrodes' contacts, as patches that are all rim."""

    def __init__(self, model: ForwardModel) -> None:
        contacts = model.prepared.contacts
        width = max(len(nodes) for nodes in contacts.nodes)
        #: nodes under each electrode, padded with −1: (g, b)
        self.rims: Indices = np.full((len(contacts.nodes), width), -1, dtype=np.int64)
        self._masses = np.zeros((len(contacts.nodes), width, width))
        for number, (nodes, mass) in enumerate(zip(contacts.nodes, contacts.masses, strict=True)):
            self.rims[number, : len(nodes)] = nodes
            self._masses[number, : len(nodes), : len(nodes)] = mass

    def rim_changes(self, change: Array) -> Array:
        """Change of the matrix under each electrode: (g,) of 1/z [S/mm] to (g, b, b) [S]."""
        return change[:, None, None] * self._masses


class Patches(Sized):
    """A set of changed elements as patches that share no node, with the coupling of their rims.

    Outside fields are described on each rim by the few that occur, without their mean.

    Parameters
    ----------
    elements : (k,) int64, each once.
    inverse : gives K₀⁻¹ between rim nodes.
    contacts : whether the contacts' impedances change too; no element may then touch one.
    """

    def __init__(self, model: ForwardModel, elements: Indices, inverse: InverseEntries, *, contacts: bool) -> None:
        members = list(split_patches(model.elements.cells[elements]))
        rims = [find_outer_nodes(model, elements[patch_elements]) for patch_elements in members]
        groups = list(_alike([(int(rim.sum()), int((~rim).sum())) for rim in rims]))
        patches = [
            PatchStack(model, [elements[members[k]] for k in group], [rims[k] for k in group]) for group in groups
        ]
        self._members = [np.concatenate([members[k] for k in group]) for group in groups]
        self._matrices = [ElementChanges(model, elements[patch_elements]) for patch_elements in self._members]
        self._patches = patches
        self._contacts = ContactStack(model) if contacts else None
        self._stacks: list[PatchStack | ContactStack] = [*patches, *([self._contacts] if self._contacts else [])]
        self._link(model, inverse)

    @property
    def nbytes(self) -> int:
        part_bytes = sum(stack.nbytes for stack in self._stacks) + sum(matrices.nbytes for matrices in self._matrices)
        arrays: list[NDArray[Any]] = [*self._members, *self._own, *self._met, *self._linked]
        return super().nbytes + part_bytes + sum(array.nbytes for array in arrays)

    def correction(self, change: Array, contact_change: Array | None) -> Array:
        """Decrease of the transfer impedance, (electrodes, electrodes) [V/A].

        Parameters
        ----------
        change : (k,) or (k, q, 2, 2) [S] of each element's conductance, leaving it positive.
        contact_change : (electrodes,) change of 1/z [S/mm], where contacts change too.
        """
        stack_responses = []
        members = zip(self._patches, self._matrices, self._members, strict=True)
        rim_changes = [
            patches.rim_changes(matrices.assemble(change[elements])) for patches, matrices, elements in members
        ]
        if self._contacts is not None and contact_change is not None:
            rim_changes.append(self._contacts.rim_changes(contact_change))
        stacks = zip(rim_changes, self._own, self._met, self._linked, strict=True)
        for rim_change, own_coupling, basis, linked in stacks:
            capacitance = rim_change @ own_coupling
            np.einsum("gii->gi", capacitance)[:] += 1
            answer = basis.swapaxes(1, 2) @ np.linalg.solve(capacitance, rim_change @ basis)  # of each patch alone
            stack_responses.append((answer @ linked).reshape(-1, linked.shape[2]))
        count = len(self._fields)
        responses = np.concatenate(stack_responses)
        system = responses[:, :count]
        np.einsum("ii->i", system)[:] += 1
        return self._fields.T @ np.linalg.solve(system, responses[:, count:])

    def _link(self, model: ForwardModel, inverse: InverseEntries) -> None:
        of_contacts = [stack is self._contacts for stack in self._stacks for _ in stack.rims]
        least = [_NEGLIGIBLE_CONTACT if contact else _NEGLIGIBLE for contact in of_contacts]
        counts = [len(stack.rims) for stack in self._stacks]
        coupling = couple(model, inverse, [rim for stack in self._stacks for rim in stack.rims], least, counts)
        self._own = [np.stack(coupling.own[block]) for block in spans_of(counts)]
        self._met = [np.stack(coupling.bases[block]) for block in spans_of(counts)]
        self._fields = coupling.fields  # (sum of ranks, electrodes)
        rows = np.hstack([coupling.between, self._fields])
        ends = np.cumsum([met.shape[0] * met.shape[2] for met in self._met])[:-1]
        self._linked = [
            block.reshape(len(met), -1, rows.shape[1])
            for block, met in zip(np.split(rows, ends), self._met, strict=True)
        ]


class ElementChanges(Sized):
    """Changes of the matrices of elements (k,) by changes of their conductance."""

    def __init__(self, model: ForwardModel, elements: Indices) -> None:
        self._stiffness = model.stiffness[elements]
        self._model, self._elements = model, elements

    @cached_property
    def _directional(self) -> Array:
        """Change by the entries of each integration point's conductance, (k, q · 4, n · n)."""
        gradients = self._model.elements.gradients[self._elements]  # (k, q, n, 2)
        weighted = self._model.elements.weights_mm2[self._elements][..., None, None] * gradients
        count, entries = len(gradients), self._stiffness[0].size
        matrices: Array = np.einsum("kqia,kqjb->kqabij", weighted, gradients).reshape(count, -1, entries)
        return matrices

    def assemble(self, change: Array) -> Array:
        """Changes (k,) or (k, q, 2, 2) [S] to matrices (k, n, n) [S]."""
        if change.ndim == 1:
            return np.asarray(change[:, None, None] * self._stiffness, dtype=np.float64)
        flat = change.reshape(len(change), 1, -1) @ self._directional
        return np.asarray(flat.reshape(self._stiffness.shape), dtype=np.float64)


def check_change(model: ForwardModel, elements: Indices, change: Array) -> None:
    """Refuse a change (k,) or (k, q, 2, 2) [S] that leaves one of the elements (k,) without conductance.

    NumericsError names the first such element.
    """
    changed = model.conductance_after_change(elements, change)
    bad = np.flatnonzero(~conducts(changed))
    if bad.size:
        raise NumericsError(
            f"the change of element {elements[bad[0]]} leaves it with a conductance of {changed[bad[0]].tolist()}"
            " S; it must stay a positive finite number, in every direction",
            remedy="give changes that leave it positive; for an insulator leave 1e-8 of the conductance",
        )


def dense_work(model: ForwardModel, elements: Indices) -> float:
    """Sum of the cubed numbers of nodes of the patches formed by elements (k,)."""
    cells = model.elements.cells[elements]
    return float(sum(len(np.unique(cells[part])) ** 3 for part in split_patches(cells)))


def _alike(sizes: Sequence[tuple[int, int]]) -> Iterator[list[int]]:
    """Groups of patches with little padding to the largest (rim, inside)."""
    group: list[int] = []
    for number in sorted(range(len(sizes)), key=lambda k: sizes[k][::-1]):
        if group and any(sizes[number][k] > 1.25 * min(sizes[n][k] for n in group) + 8 for k in (0, 1)):
            yield group
            group = []
        group.append(number)
    if group:
        yield group
