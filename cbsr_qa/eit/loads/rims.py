"""Rims of changed patches: entries of K⁻¹ between their nodes, and their coupling in few modes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.eit.forward.model import ForwardModel

#: Largest number of nodes kept: 2048² entries are 34 MB, and suffice for some seventy heads on a mesh of 2.5 mm.
MOST_NODES: Final = 2048
_AT_ONCE: Final = 16  # nodes solved for together: few enough for their full columns to stay in the cache


class InverseEntries:
    """The part of K⁻¹ for a growing set of nodes; restarted when it would exceed its bound."""

    def __init__(self, model: ForwardModel) -> None:
        self._model = model
        self._place = np.full(model.elements.count, -1, dtype=np.int64)
        self._known: Indices = np.empty(0, dtype=np.int64)
        self._entries: Array = np.empty((0, 0))

    @property
    def nbytes(self) -> int:
        return self._entries.nbytes

    def entries(self, nodes: Indices) -> Array:
        """Return the entries between distinct nodes (p,): (p, p) [V/A]."""
        new_nodes = self._missing(nodes)
        self._reserve(new_nodes)
        for begin in range(0, len(new_nodes), _AT_ONCE):
            chunk = new_nodes[begin : begin + _AT_ONCE]
            self._keep(chunk, self._columns(chunk))
        place = self._place[nodes]
        return self._entries[np.ix_(place, place)]

    def solve_between(self, nodes: Indices) -> Array:
        """Return the entries between distinct nodes (p,), solved for these alone: (p, p) [V/A].

        Identical to the last bit, independent of earlier calls, unlike :meth:`between`.
        """
        new_nodes = self._missing(nodes)
        self._reserve(new_nodes)
        entries = np.empty((len(nodes), len(nodes)))
        for begin in range(0, len(nodes), _AT_ONCE):
            chunk = slice(begin, begin + _AT_ONCE)
            columns = self._columns(nodes[chunk])
            entries[:, chunk] = columns[nodes]
            is_new = np.isin(nodes[chunk], new_nodes)
            self._keep(nodes[chunk][is_new], columns[:, is_new])
        return entries

    def _missing(self, nodes: Indices) -> Indices:
        """Unknown ones among these nodes; all if the known ones had to be discarded."""
        new_nodes = nodes[self._place[nodes] < 0]
        if new_nodes.size and len(self._known) + new_nodes.size > MOST_NODES:
            self._place[self._known] = -1
            self._known = self._known[:0]
            self._entries = np.empty((0, 0))
            return nodes
        return new_nodes

    def _reserve(self, nodes: Indices) -> None:
        old_count, new_count = len(self._known), len(self._known) + len(nodes)
        self._known = np.concatenate([self._known, nodes])
        self._place[nodes] = np.arange(old_count, new_count)
        self._make_room(old_count, new_count)

    def _columns(self, nodes: Indices) -> Array:
        load = np.zeros((len(self._place), len(nodes)))
        load[nodes, np.arange(len(nodes))] = 1
        return self._model.solve(load)

    def _keep(self, nodes: Indices, columns: Array) -> None:
        """Store the entries of columns between all nodes known so far."""
        count, places = len(self._known), self._place[nodes]
        self._entries[:count, places] = columns[self._known]
        self._entries[places, :count] = columns[self._known].T

    def _make_room(self, used: int, needed: int) -> None:
        if needed <= len(self._entries):
            return
        size = max(needed, min(2 * len(self._entries), MOST_NODES))
        larger_entries = np.zeros((size, size))
        larger_entries[:used, :used] = self._entries[:used, :used]
        self._entries = larger_entries


def find_outer_nodes(model: ForwardModel, elements: Indices) -> Mask:
    """Whether each of a patch's sorted nodes belongs to an element that does not change, or to an electrode."""
    nodes, corner = np.unique(model.elements.cells[elements], return_inverse=True)
    contacts = np.concatenate(model.prepared.contacts.nodes)
    everywhere = model.elements.elements_per_node[nodes]
    return (np.bincount(corner.ravel()) < everywhere) | np.isin(nodes, contacts)


def split_patches(corners: Indices) -> Iterator[Indices]:
    """Indices of the elements of each patch."""
    nodes, local = np.unique(corners[:, :3], return_inverse=True)
    local = local.reshape(-1, 3)
    pairs = local[:, :2].ravel(), local[:, 1:].ravel()
    graph = sparse.coo_array((np.ones(len(pairs[0])), pairs), shape=(len(nodes), len(nodes)))
    count, patch = connected_components(graph, directed=False)
    for number in range(count):
        yield np.flatnonzero(patch[local[:, 0]] == number)


def spans_of(lengths: Sequence[int]) -> list[slice]:
    """Slices of successive parts of given lengths."""
    ends = np.cumsum(lengths).tolist()
    return [slice(end - length, end) for end, length in zip(ends, lengths, strict=True)]


def couple_rims(
    model: ForwardModel, inverse: InverseEntries, rims: Sequence[Indices], spans: Sequence[slice]
) -> tuple[Array, Array]:
    """K₀⁻¹ between all rims and the electrodes' fields there, without their means on each rim; 0 in the padding."""
    nodes = np.concatenate(rims)
    is_real = nodes >= 0
    coupling = np.zeros((len(nodes), len(nodes)))
    distinct_nodes, place = np.unique(
        nodes[is_real], return_inverse=True
    )  # adjacent patches share nodes of their rims
    coupling[np.ix_(is_real, is_real)] = inverse.entries(distinct_nodes)[np.ix_(place, place)]
    fields = np.zeros((len(nodes), len(model.contact_impedance)))
    fields[is_real] = model.electrode_fields[nodes[is_real]]
    for span in spans:
        is_node = is_real[span].astype(np.float64)
        mean = is_node / is_node.sum()
        fields[span] -= np.outer(is_node, mean @ fields[span])
        coupling[span] -= np.outer(is_node, mean @ coupling[span])
        coupling[:, span] -= np.outer(coupling[:, span] @ mean, is_node)
    return coupling, fields


def invert_rim(inverse: InverseEntries, rim: Indices) -> Array:
    """K₀⁻¹ between the nodes of one rim, without its means; independent of earlier loads."""
    coupling = inverse.solve_between(rim)
    coupling -= coupling.mean(axis=0)
    coupling -= coupling.mean(axis=1)[:, None]
    return coupling


def truncate_fields(between: Array, fields: Array, spans: Sequence[slice], least: Sequence[float]) -> list[Array]:
    """Orthonormal bases (b, r) of the fields at each rim from other rims and electrodes, truncated."""
    bases = []
    for span, negligible in zip(spans, least, strict=True):
        # The factor R of the transpose has the same left vectors, and is square.
        square: Array = np.asarray(np.linalg.qr(np.vstack([between[span].T, fields[span].T]), mode="r"))
        basis, size, _ = np.linalg.svd(square.T, full_matrices=False)
        rank = max(1, int((size > negligible * max(size[0], np.finfo(float).tiny)).sum()))
        bases.append(basis[:, :rank])
    return bases


def pad_bases(bases: Sequence[Array]) -> list[Array]:
    """Bases of one stack, padded with zeros to the largest rank."""
    rank = max((basis.shape[1] for basis in bases), default=0)
    return [np.pad(basis, ((0, 0), (0, rank - basis.shape[1]))) for basis in bases]


@dataclass(frozen=True, slots=True, eq=False)
class Coupling:
    """Coupling of patches and electrodes, in the few fields that occur.

    Parameters
    ----------
    own : K₀⁻¹ on each rim, without its means: (b, b) each.
    bases : basis of the fields at each rim: (b, r) each.
    between : K₀⁻¹ between different rims in these: (sum of ranks,) * 2.
    fields : fields of the electrodes in these bases: (sum of ranks, electrodes).
    """

    own: list[Array]
    bases: list[Array]
    between: Array
    fields: Array


def couple(
    model: ForwardModel,
    inverse: InverseEntries,
    rims: Sequence[Indices],
    least: Sequence[float],
    stacks: Sequence[int],
) -> Coupling:
    """Describe the fields at each rim, and the coupling of rims and electrodes.

    Parameters
    ----------
    rims : nodes of each, padded with −1.
    least : size of omitted fields at each rim, over the largest.
    stacks : numbers of successive rims whose bases are padded to one rank.
    """
    spans = spans_of([len(rim) for rim in rims])
    coupling, fields = couple_rims(model, inverse, rims, spans)
    own_couplings = [coupling[span, span].copy() for span in spans]
    for span in spans:
        coupling[span, span] = 0
    field_bases = truncate_fields(coupling, fields, spans, least)
    bases = [basis for stack_span in spans_of(stacks) for basis in pad_bases(field_bases[stack_span])]
    places = spans_of([basis.shape[1] for basis in bases])
    basis_matrix = np.zeros((len(fields), places[-1].stop))
    for span, place, basis in zip(spans, places, bases, strict=True):
        basis_matrix[span, place] = basis
    return Coupling(own_couplings, bases, basis_matrix.T @ coupling @ basis_matrix, basis_matrix.T @ fields)
