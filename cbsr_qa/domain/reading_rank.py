"""How many of many sparse linear functions are independent."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

#: Coefficients by unknown; none is zero.
Functional = dict[tuple[int, int], int]

#: Of the largest: eigenvalues below count as zero. Coefficients are small whole numbers.
_ZERO: Final = 1e-10


def rank_of(functionals: Sequence[Functional]) -> int:
    """Return the rank of functionals with few entries each.

    One with an unknown that no other has is independent of them; it is counted and taken away, which may free the
    next. Little is left of patterns without a system, nothing of ``"adjacent"``; the rest is counted by eigenvalues.
    """
    holders: dict[tuple[int, int], set[int]] = defaultdict(set)
    for row, functional in enumerate(functionals):
        for unknown in functional:
            holders[unknown].add(row)
    left = set(range(len(functionals)))
    free = [unknown for unknown, rows in holders.items() if len(rows) == 1]
    while free:
        rows = holders[free.pop()]
        if not rows:
            continue
        (row,) = rows
        left.discard(row)
        for unknown in functionals[row]:
            holders[unknown].discard(row)
            if len(holders[unknown]) == 1:
                free.append(unknown)
    core = [functionals[row] for row in sorted(left)]
    return len(functionals) - len(core) + _dense_rank(core)


def _dense_rank(functionals: Sequence[Functional]) -> int:
    if not functionals:
        return 0
    unknowns = {unknown: k for k, unknown in enumerate(sorted({u for f in functionals for u in f}))}
    matrix: NDArray[np.float64] = np.zeros((len(functionals), len(unknowns)))
    for row, functional in enumerate(functionals):
        for unknown, coefficient in functional.items():
            matrix[row, unknowns[unknown]] = coefficient
    gram = matrix @ matrix.T if len(functionals) <= len(unknowns) else matrix.T @ matrix
    eigenvalues = np.linalg.eigvalsh(gram)
    return int((eigenvalues > _ZERO * eigenvalues[-1]).sum())
