"""Rims of changed patches: coupling between them and to the electrodes, in few modes."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from cbsr_qa.domain import Array, Indices, Mask
from cbsr_qa.eit.forward import ForwardModel, InverseEntries


def seen_outside(model: ForwardModel, elements: Indices) -> Mask:
    """Whether each of a patch's sorted nodes belongs to an element that does not change, or to an electrode."""
    nodes, corner = np.unique(model.elements.cells[elements], return_inverse=True)
    contacts = np.concatenate(model.prepared.contacts.nodes)
    everywhere = model.elements.elements_per_node[nodes]
    return (np.bincount(corner.ravel()) < everywhere) | np.isin(nodes, contacts)


def connected_parts(corners: Indices) -> Iterator[Indices]:
    """Indices of the elements of each patch."""
    nodes, local = np.unique(corners[:, :3], return_inverse=True)
    local = local.reshape(-1, 3)
    pairs = local[:, :2].ravel(), local[:, 1:].ravel()
    graph = sparse.coo_array((np.ones(len(pairs[0])), pairs), shape=(len(nodes), len(nodes)))
    count, patch = connected_components(graph, directed=False)
    for number in range(count):
        yield np.flatnonzero(patch[local[:, 0]] == number)


def spans_of(lengths: Sequence[int]) -> list[slice]:
    """Slices of successive parts that are so long."""
    ends = np.cumsum(lengths).tolist()
    return [slice(end - length, end) for end, length in zip(ends, lengths, strict=True)]


def between_rims(
    model: ForwardModel, inverse: InverseEntries, rims: Sequence[Indices], spans: Sequence[slice]
) -> tuple[Array, Array]:
    """K₀⁻¹ between all rims and the electrodes' fields there, without their means on each rim; 0 where filled up."""
    nodes = np.concatenate(rims)
    real = nodes >= 0
    between = np.zeros((len(nodes), len(nodes)))
    each, place = np.unique(nodes[real], return_inverse=True)  # patches side by side share nodes of their rims
    between[np.ix_(real, real)] = inverse.between(each)[np.ix_(place, place)]
    fields = np.zeros((len(nodes), len(model.contact_impedance)))
    fields[real] = model.electrode_fields[nodes[real]]
    for span in spans:
        use = real[span].astype(np.float64)
        mean = use / use.sum()
        fields[span] -= np.outer(use, mean @ fields[span])
        between[span] -= np.outer(use, mean @ between[span])
        between[:, span] -= np.outer(between[:, span] @ mean, use)
    return between, fields


def own_rim(inverse: InverseEntries, rim: Indices) -> Array:
    """K₀⁻¹ between the nodes of one rim, without its means; independent of earlier loads."""
    own = inverse.alone(rim)
    own -= own.mean(axis=0)
    own -= own.mean(axis=1)[:, None]
    return own


def met_bases(between: Array, fields: Array, spans: Sequence[slice], least: Sequence[float]) -> list[Array]:
    """Orthonormal bases (b, r) of the fields that reach each rim from other rims and electrodes, truncated."""
    found = []
    for span, negligible in zip(spans, least, strict=True):
        # The factor R of the transpose has the same left vectors, and is square.
        square: Array = np.asarray(np.linalg.qr(np.vstack([between[span].T, fields[span].T]), mode="r"))
        basis, size, _ = np.linalg.svd(square.T, full_matrices=False)
        rank = max(1, int((size > negligible * max(size[0], np.finfo(float).tiny)).sum()))
        found.append(basis[:, :rank])
    return found


def filled_up(bases: Sequence[Array]) -> list[Array]:
    """Bases of one stack, with zeros up to the largest rank."""
    rank = max((basis.shape[1] for basis in bases), default=0)
    return [np.pad(basis, ((0, 0), (0, rank - basis.shape[1]))) for basis in bases]
