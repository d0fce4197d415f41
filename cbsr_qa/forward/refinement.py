"""Iterative refinement of potentials: what rounding lets leak from good conductors is put back.

A row of the matrix holds the sum of its conductances on the diagonal. Rounding that sum leaks some 1e-16 of the best
conductor's current out of the sheet, which counts against the worst conductor that current has to pass: with
contrasts of 1e8, readings that the problem itself would determine to 1e-15 were right to 1e-8. Here residuals are
formed without the diagonal, as Σ_j K_ij (u_j − u_i), of potentials in twice the precision (Dekker 1971): what flows
into a node then flows out of it again to the last digit. Corrections from the same factors are added until they
vanish or are of rounding (Wilkinson 1963; Demmel et al. 2006), which takes two or three.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError

Array = NDArray[np.float64]
SparseIndices = NDArray[np.int32]

_MOST_STEPS: Final = 12
_DONE: Final = 1e-13  # of the largest potential: the next correction would be one of rounding
_SHRINKS: Final = 0.5  # a correction that is no smaller than so much of the last one is of rounding already
_LOST: Final = 1e-2  # of the largest potential: corrections that end above were never any


@dataclass(frozen=True, slots=True, eq=False)
class Conductors:
    """A symmetric matrix whose rows sum to zero, as what joins its nodes.

    Parameters
    ----------
    values : (k,) entries column by column; those on the diagonal do not count.
    row : (k,) int32 of each entry. start : (n + 1,) int32, where each column's entries begin; none is empty.
    """

    values: Array
    row: SparseIndices
    start: SparseIndices

    def out_of(self, high: Array, low: Array) -> Array:
        """Current out of each node into the others for potentials high + low, (n, k) [V] both: (n, k) [A]."""
        counts = np.diff(self.start)
        one, other = high[self.row], np.repeat(high, counts, axis=0)
        difference, lost = _difference(one, other)
        lost += low[self.row] - np.repeat(low, counts, axis=0)
        flow = self.values[:, None] * (difference + lost)
        return np.asarray(np.add.reduceat(flow, self.start[:-1], axis=0), dtype=np.float64)


def refined(
    conductors: Conductors, load: Array, solve: Callable[[Array], Array], potentials: Array, ground: int
) -> tuple[Array, Array]:
    """Refine potentials until they are those of the conductors to rounding.

    Parameters
    ----------
    load : (n, k) currents into the nodes, columns that sum to zero [A].
    solve : gives potentials of a load, nearly.
    potentials : (n, k) to begin with [V].
    ground : a node; potentials are returned against it, small ones near it with all their digits.

    Returns
    -------
    (n, k) and (n, k) [V], rounded and what rounding took: their sum has differences that are right to their own size,
    as between nodes of a good conductor.

    Raises
    ------
    NumericsError
        If corrections do not shrink: the factors have no digit left.
    """
    high, low = potentials - potentials[ground], np.zeros_like(potentials)
    left = np.inf
    for _ in range(_MOST_STEPS):
        correction = solve(load - conductors.out_of(high, low))
        correction -= correction[ground]
        high, lost = _sum(high, correction)
        high, low = _sum(high, low + lost)
        before, left = left, _share(correction, high)
        if left <= _DONE or left > _SHRINKS * before:
            break
    if not left <= _LOST:
        raise NumericsError(
            "the sheet's potentials cannot be refined: its conductances and contacts are too far apart",
            remedy="bring conductances and contact impedances closer to each other",
        )
    return high, low


def _share(correction: Array, potentials: Array) -> float:
    """Largest correction of a column over its largest potential, of all columns the worst."""
    largest = np.abs(potentials).max(axis=0)
    share: float = (np.abs(correction).max(axis=0)[largest > 0] / largest[largest > 0]).max(initial=0.0)
    return float(share)


def _sum(one: Array, other: Array) -> tuple[Array, Array]:
    """Rounded sum, and what rounding lost of it (Knuth)."""
    total = one + other
    part = total - one
    return total, (one - (total - part)) + (other - part)


def _difference(one: Array, other: Array) -> tuple[Array, Array]:
    """Rounded difference, and what rounding lost of it."""
    return _sum(one, -other)
