"""Entries of K⁻¹ between the nodes requested so far; each node is solved for once."""

from typing import Final

import numpy as np

from cbsr_qa.domain import Array, Indices
from cbsr_qa.eit.forward.model import ForwardModel

#: More nodes than this are not kept: 2048² entries are 34 MB, and hold some seventy heads on a mesh of 2.5 mm.
MOST_NODES: Final = 2048
_AT_ONCE: Final = 16  # nodes solved for together: few enough for their full columns to stay in the cache


class InverseEntries:
    """The part of K⁻¹ that belongs to a growing set of nodes.

    K is symmetric, so the entries of known nodes against a new one are in the new one's column already, and columns
    need not be kept whole. When the set would outgrow its bound, it begins anew with the nodes asked for.

    Parameters
    ----------
    model : its factorisation solves for the columns.
    most : nodes kept, unless more are asked for at once.
    """

    def __init__(self, model: ForwardModel, *, most: int = MOST_NODES) -> None:
        self._model = model
        self._most = most
        self._place = np.full(model.elements.count, -1, dtype=np.int64)
        self._known: Indices = np.empty(0, dtype=np.int64)
        self._entries: Array = np.empty((0, 0))

    @property
    def nbytes(self) -> int:
        """Memory the entries take."""
        return self._entries.nbytes

    def between(self, nodes: Indices) -> Array:
        """Return the entries between nodes: (p, p) [V/A].

        Parameters
        ----------
        nodes : (p,) int64, each once.
        """
        missing = self._missing(nodes)
        self._reserve(missing)
        for first in range(0, len(missing), _AT_ONCE):
            part = missing[first : first + _AT_ONCE]
            self._keep(part, self._columns(part))
        place = self._place[nodes]
        return self._entries[np.ix_(place, place)]

    def alone(self, nodes: Indices) -> Array:
        """Return the entries between nodes as solving for these alone gives them: (p, p) [V/A].

        The same to the last bit whatever was asked before, unlike :meth:`between`, whose entries come from the column
        of whichever node was asked for later. What is solved for is known to :meth:`between` from then on.

        Parameters
        ----------
        nodes : (p,) int64, each once.
        """
        missing = self._missing(nodes)
        self._reserve(missing)
        entries = np.empty((len(nodes), len(nodes)))
        for first in range(0, len(nodes), _AT_ONCE):
            here = slice(first, first + _AT_ONCE)
            columns = self._columns(nodes[here])
            entries[:, here] = columns[nodes]
            new = np.isin(nodes[here], missing)
            self._keep(nodes[here][new], columns[:, new])
        return entries

    def _missing(self, nodes: Indices) -> Indices:
        """Which of these are not known; all of them where the known ones had to be forgotten."""
        missing = nodes[self._place[nodes] < 0]
        if missing.size and len(self._known) + missing.size > self._most:
            self._forget()
            return nodes
        return missing

    def _forget(self) -> None:
        self._place[self._known] = -1
        self._known = self._known[:0]
        self._entries = np.empty((0, 0))

    def _reserve(self, nodes: Indices) -> None:
        """Give nodes their places."""
        before, after = len(self._known), len(self._known) + len(nodes)
        self._known = np.concatenate([self._known, nodes])
        self._place[nodes] = np.arange(before, after)
        self._make_room(before, after)

    def _columns(self, nodes: Indices) -> Array:
        """Whole columns of K⁻¹, (n, p)."""
        load = np.zeros((len(self._place), len(nodes)))
        load[nodes, np.arange(len(nodes))] = 1
        return self._model.solve(load)

    def _keep(self, nodes: Indices, columns: Array) -> None:
        """Store the entries of columns between all nodes known so far."""
        count, here = len(self._known), self._place[nodes]
        self._entries[:count, here] = columns[self._known]
        self._entries[here, :count] = columns[self._known].T

    def _make_room(self, used: int, needed: int) -> None:
        """Grow by doubling, so that adding nodes one after the other costs no more than a few copies in all."""
        if needed <= len(self._entries):
            return
        size = max(needed, min(2 * len(self._entries), self._most))
        grown = np.zeros((size, size))
        grown[:used, :used] = self._entries[:used, :used]
        self._entries = grown
