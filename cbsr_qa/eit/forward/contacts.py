"""Electrodes on the mesh: along boundary edges, or at single nodes."""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain import Array, Indices, NumericsError
from cbsr_qa.eit.forward.elements import FiniteElements


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """Electrodes as the nodes see them.

    Parameters
    ----------
    means : (n, electrodes) weights of the mean potential under each electrode; columns sum to one.
    lengths_mm : (electrodes,) ∞ for points, which have no contact impedance.
    nodes : for each electrode, the (b,) nodes it touches.
    masses : for each electrode, ∫ (u − ū)(v − v̄) ds over those nodes, (b, b) [mm]; zero for points.
    """

    means: Array
    lengths_mm: Array
    nodes: tuple[Indices, ...]
    masses: tuple[Array, ...]


def edge_contacts(elements: FiniteElements) -> Contacts:
    """Electrodes of the complete electrode model, along the mesh's electrode edges.

    Raises
    ------
    NumericsError
        If an electrode has no edges, or edges that no element has.
    """
    electrodes = elements.mesh.electrode_edges
    bare = [k for k, edges in enumerate(electrodes) if not len(edges)]
    if bare or not electrodes:
        raise NumericsError(
            f"the mesh carries {len(electrodes) - len(bare)} electrodes with edges",
            remedy=f"give edges to electrode {bare[0]}" if bare else "use a mesh that carries electrodes",
        )
    means = np.zeros((elements.count, len(electrodes)))
    lengths, nodes, masses = np.zeros(len(electrodes)), [], []
    for number, edges in enumerate(electrodes):
        touched, local = np.unique(elements.along(edges), return_inverse=True)
        local = local.reshape(len(edges), -1)
        mass = np.zeros((len(touched), len(touched)))
        np.add.at(mass, (local[:, :, None], local[:, None, :]), elements.edge_masses(edges))
        share = mass.sum(axis=1)
        lengths[number] = share.sum()
        means[touched, number] = share / lengths[number]
        nodes.append(touched.astype(np.int64))
        masses.append(mass - np.outer(share, share) / lengths[number])
    return Contacts(means, lengths, tuple(nodes), tuple(masses))


def point_contacts(elements: FiniteElements, nodes: Indices) -> Contacts:
    """Electrodes that are single nodes: the limit of narrow ones, away from themselves.

    Parameters
    ----------
    nodes : (electrodes,) nodes of the mesh, each once.

    Raises
    ------
    NumericsError
        If a node is not in the mesh, or carries two electrodes.
    """
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
