"""Loads of fixed shape and varying strength: their response on the rim, tabulated.

With X = (I + ΔΛ W)⁻¹ ΔΛ the response of a patch to the fields at its rim (:mod:`cbsr_qa.eit.loads.local`), X/s is
analytic in the strength s wherever all elements still conduct, and so is the change of the elements over s: a
Chebyshev series of a few terms is exact to rounding (Trefethen 2013, theorem 8.2).
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.loads.patches import ElementChanges, PatchStack, Sized, check_change
from cbsr_qa.eit.loads.rims import InverseEntries, find_outer_nodes, invert_rim

#: Largest total strength and largest number of overlapping loads that are treated as residues.
WEAK: Final = 2e-3
_MOST_WEAK: Final = 8
#: Terms of a series, and size of its last ones relative to its largest.
TERMS: Final = 24
_ROUNDING: Final = 1e-13
_REACH: Final = 0.3  # a head at half strain on the shipped materials
_HALVINGS: Final = 8
_SAFE: Final = 0.5  # of an element's conductance: smaller changes leave some in any direction


class Series:
    """f(s)/s as a Chebyshev series where |s| is at most ``reach``; f itself, zero at zero, beyond.

    ``reach`` is halved until the series has converged; NumericsError if f cannot be computed even for small s.
    """

    def __init__(self, exact: Callable[[float], Array], *, reach: float = _REACH) -> None:
        self._exact = exact
        places = np.cos(np.pi * (np.arange(TERMS) + 0.5) / TERMS)
        self.coefficients: Array = np.zeros((TERMS, 1))
        for halving in range(_HALVINGS if reach else 0):
            self.reach = reach * 0.5**halving
            try:
                values = np.array([exact(float(s)) / s for s in self.reach * places])
            except NumericsError:
                if halving == _HALVINGS - 1:
                    raise
                continue
            #: (terms, …)
            order = np.arange(TERMS)
            matrix = 2 / TERMS * np.cos(np.pi * np.outer(order, order + 0.5) / TERMS)
            matrix[0] /= 2
            self.coefficients = np.tensordot(matrix, values, 1)
            size = np.abs(self.coefficients).reshape(TERMS, -1).max(axis=1)
            if size[-2:].max() <= _ROUNDING * size.max():
                return
        self.reach = 0.0  # not smooth: always computed exactly

    def __call__(self, strength: float) -> Array:
        """Return f(s)."""
        if not abs(strength) <= self.reach or not strength:
            return self._exact(strength)
        return strength * np.tensordot(polynomials(strength / self.reach), self.coefficients, 1)


def polynomials(x: float | Array) -> Array:
    """Chebyshev polynomials T₀ … at x in [−1, 1]: (…) to (…, terms)."""
    values: Array = np.cos(np.arange(TERMS) * np.arccos(np.clip(np.asarray(x), -1, 1))[..., None])
    return values


class StackedSeries(Sized):
    """Changes of elements by several loads, added up where they overlap.

    Parameters
    ----------
    series : series of the change of each load, (k, q, 2, 2) each.
    places : (k,) int64 indices of the elements of each load among all.
    shape : (all elements, q, 2, 2).
    """

    def __init__(self, series: Sequence[Series], places: Sequence[Indices], shape: tuple[int, ...]) -> None:
        self._series, self._places = tuple(series), places
        self._reach = np.array([load.reach for load in series])
        self._shape = shape
        terms, owners, orders = [], [], []
        for number, (load, place) in enumerate(zip(series, places, strict=True)):
            size = np.abs(load.coefficients).reshape(TERMS, -1).max(axis=1)
            kept_orders = (
                np.flatnonzero(size > np.finfo(float).eps * size.max()) if load.reach else np.zeros(0, dtype=np.int64)
            )
            spread = np.zeros((len(kept_orders), *self._shape))
            if kept_orders.size:
                spread[:, place] = load.coefficients[kept_orders]
            terms.append(spread.reshape(len(kept_orders), -1))
            owners.append(np.full(len(kept_orders), number))
            orders.append(kept_orders)
        self._terms = np.concatenate(terms)
        self._owner, self._order = np.concatenate(owners), np.concatenate(orders)
        # Largest entry by strength, of matrices of two by two.
        self._slope = np.array([2 * np.abs(load.coefficients).sum(axis=0).max() for load in series])

    def __call__(self, strengths: Array) -> Array:
        """Return the sum of all changes for (n,) strengths: (all elements, q, 2, 2)."""
        is_within_reach = np.abs(strengths) <= self._reach
        series_strengths = np.where(is_within_reach, strengths, 0.0)
        angle = np.arccos(np.clip(series_strengths / np.where(self._reach > 0, self._reach, 1.0), -1, 1))
        factors = series_strengths[self._owner] * np.cos(self._order * angle[self._owner])
        change: Array = (factors @ self._terms).reshape(self._shape)
        for number in np.flatnonzero(~is_within_reach).tolist():
            change[self._places[number]] += self._series[number](float(strengths[number]))
        return change

    def limit_entries(self, strengths: Sequence[float]) -> float:
        """Upper bound of all entries of the sum; infinite if a strength is beyond its series."""
        if (np.abs(strengths) > self._reach).any():
            return float("inf")
        return float(np.abs(strengths) @ self._slope)


class LoadFamily:
    """A load of one shape at one place, for any strength.

    Parameters
    ----------
    elements : (k,) int64, rising.
    change : function of the strength that returns the change of their conductance, (k, q, 2, 2) [S]; zero at zero.
    """

    def __init__(self, elements: Indices, change: Callable[[float], Array]) -> None:
        self.elements = elements
        self.change = Series(change)


class Patch:
    """The elements of one load, or of several that overlap, as seen from their rim."""

    def __init__(self, model: ForwardModel, inverse: InverseEntries, families: Sequence[LoadFamily]) -> None:
        self.families = tuple(families)
        self._elements = np.unique(np.concatenate([family.elements for family in families]))
        self._model = model
        self._stack = PatchStack(model, [self._elements], [find_outer_nodes(model, self._elements)])
        self._matrices = ElementChanges(model, self._elements)
        #: (b,) nodes of its rim
        self.rim: Indices = self._stack.rims[0]
        self._own = invert_rim(inverse, self.rim)
        shape = len(self._elements), len(model.elements.shapes.points), 2, 2
        places = [np.searchsorted(self._elements, family.elements) for family in families]
        self._stacked = StackedSeries([family.change for family in families], places, shape)
        self._least = float(model.conductance[self._elements].min())
        #: X as a function of the strength of a single load; None for several
        self.series = None if families[1:] else Series(lambda s: self.answer([s]), reach=families[0].change.reach)

    @property
    def nbytes(self) -> int:
        """Memory beside its loads, mostly tables [bytes]."""
        tables = [self._own, *vars(self).get("_weak", ()), *([self.series.coefficients] if self.series else [])]
        part_bytes = self._stack.nbytes + self._matrices.nbytes + self._stacked.nbytes
        return part_bytes + sum(int(table.nbytes) for table in tables)

    def answer(self, strengths: Sequence[float]) -> Array:
        """X for the strengths of its loads, without a series: (b, b) [S].

        Overlapping residues are included to second order in their strengths. NumericsError if an element is left
        without conductance.
        """
        if 1 < len(strengths) <= _MOST_WEAK and sum(map(abs, strengths)) <= WEAK:
            linear, quadratic = self._weak
            vector = np.asarray(strengths)
            powers = np.concatenate([vector, np.outer(vector, vector)[np.triu_indices(len(vector))]])
            return np.tensordot(powers, np.concatenate([linear, quadratic]), 1)
        return self._exact(strengths)

    @cached_property
    def _weak(self) -> tuple[Array, Array]:
        """Coefficients of the strengths (n, b, b), and of their products, pair by pair (n (n + 1)/2, b, b)."""
        count, step = len(self.families), WEAK
        unit = step * np.eye(count)
        raised, lowered = (np.array([self._exact((sign * row).tolist()) for row in unit]) for sign in (1, -1))
        pairs = []
        for i, j in zip(*np.triu_indices(count), strict=True):
            if i == j:
                pairs.append((raised[i] + lowered[i]) / (2 * step**2))
            else:
                pair_sum = self._exact((unit[i] + unit[j]).tolist()) + self._exact((-unit[i] - unit[j]).tolist())
                pairs.append((pair_sum - raised[i] - lowered[i] - raised[j] - lowered[j]) / (2 * step**2))
        return (raised - lowered) / (2 * step), np.array(pairs)

    def _exact(self, strengths: Sequence[float]) -> Array:
        change = self._stacked(np.asarray(strengths))
        if not self._stacked.limit_entries(strengths) < _SAFE * self._least:
            check_change(self._model, self._elements, change)
        rim_change = self._stack.rim_changes(self._matrices.assemble(change))[0]
        return np.linalg.solve(np.eye(len(rim_change)) + rim_change @ self._own, rim_change)
