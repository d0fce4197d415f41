"""Allowed range of conductances and contact impedances; outside it rounding would dominate the readings.

Rounding lets current leak out of a row of the matrix, some 1e-16 of its largest entry: of the best conductor, and of
|E|/z under a contact. The leak matters relative to the worst conductor in the current's path. If values differ by
more than a factor of a hundred, potentials are refined (:mod:`cbsr_qa.eit.forward.prepared`); readings that touch no
driven electrode are then accurate to 1e-13 in norm over the allowed range, also after local updates (1e-12 if every
element has its own conductance, over eight decades).
"""

from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices, Mask

#: Allowed range of z γ/|E| of an electrode with the conductance next to it.
CONTACT_RANGE: Final = (1e-9, 1e9)
#: The same with the smallest and the largest conductance of the sheet, which may lie in the current's path.
FAR_CONTACT_RANGE: Final = (1e-10, 1e10)
#: Largest allowed ratio of the largest to the smallest conductance.
MOST_CONTRAST: Final = 1e8
#: Ratio of conductances, including contacts, above which potentials are refined.
REFINED_ABOVE: Final = 1e2
#: Relative rounding error of readings and sensitivities that are not refined, per ratio of conductances.
UNREFINED_ERROR: Final = 1.5e-14
_ROUNDING: Final = 1 + 1e-9  # tolerance of a contrast exactly at the limit


_NOTHING: Final = {
    "conductance": "give an insulator 1e-8 of the others' conductance, or leave it out of the mesh",
    "contact impedance": "give a perfect contact a small one, e.g. 1e-6 of the electrode's length over conductance",
}


class ValueRangeError(NumericsError):
    """Conductances or contacts are too far apart for readings that are more than rounding."""


def least_and_most(conductance: Array) -> tuple[Array, Array]:
    """Smallest and largest conductance in any direction, (m,) [S] each, of (m,) or (m, q, 2, 2)."""
    if conductance.ndim == 1:
        return conductance, conductance
    xx, xy, yy = conductance[..., 0, 0], conductance[..., 0, 1], conductance[..., 1, 1]
    largest = (xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)
    smallest = (xx * yy - xy * xy) / largest  # the determinant is the product of both
    return smallest.min(axis=1), largest.max(axis=1)


def check_range(conductance: Array, impedance: Array, lengths_mm: Array, beside: tuple[Indices, ...]) -> bool:
    """Refuse values of which rounding would decide the readings.

    Parameters
    ----------
    conductance : (e,) [S], or (e, q, 2, 2) by integration point.
    impedance : (electrodes,) z [Ω·mm].
    lengths_mm : (electrodes,) |E|; infinite for points, which have no contact impedance.
    beside : elements that touch each electrode.

    Returns
    -------
    Whether potentials must be refined, because rounding would cost readings more than about two digits.

    Raises
    ------
    ValueRangeError
        Conductances further apart than :data:`MOST_CONTRAST`, naming the two elements; or a contact out of
        :data:`CONTACT_RANGE`, naming the first electrode, its ratio z γ/|E| and what is allowed.
    """
    least, largest = least_and_most(conductance)
    low, high = int(least.argmin()), int(largest.argmax())
    if largest[high] / MOST_CONTRAST > least[low] * _ROUNDING:
        raise ValueRangeError(
            f"conductance {high} is {largest[high]:g} S and conductance {low} is {least[low]:g} S, a contrast above"
            f" {MOST_CONTRAST:g}: rounding would decide the readings",
            remedy=f"bring conductances to within a factor of {MOST_CONTRAST:g} of each other",
        )
    best, worst = largest.max(), least.min()
    if np.isinf(lengths_mm).any():
        return bool(best > REFINED_ABOVE * worst)
    length = impedance / lengths_mm
    neighbour_extremes = (
        np.array([least[neighbours].min() for neighbours in beside]),
        np.array([largest[neighbours].max() for neighbours in beside]),
    )
    for conductance_name, (lowest, highest), allowed in (
        ("the conductance next to it", neighbour_extremes, CONTACT_RANGE),
        ("the sheet's smallest or largest conductance", (worst, best), FAR_CONTACT_RANGE),
    ):
        _check_ratios(length * lowest, length * highest, impedance, conductance_name, allowed)
    return bool(max(best, (lengths_mm / impedance).max()) > REFINED_ABOVE * worst)


def _check_ratios(low: Array, high: Array, impedance: Array, where: str, allowed: tuple[float, float]) -> None:
    bad = np.flatnonzero((low < allowed[0]) | (high > allowed[1]))
    if bad.size:
        k = bad[0]
        too_low = low[k] < allowed[0]
        raise ValueRangeError(
            f"contact impedance {k} is {impedance[k]:g} Ω·mm, {(low if too_low else high)[k]:.3g} of the"
            f" electrode's length over {where} (z γ/|E|; one of {bad.size} such); {allowed[0]:g} to {allowed[1]:g}"
            " are allowed: outside this range rounding would decide the readings",
            remedy=f"{'raise' if too_low else 'lower'} it; readings that touch no driven electrode hardly change",
        )


def conducts(conductance: Array) -> Mask:
    """Whether conductances (m,) or (m, q, 2, 2) are finite and positive (matrices: symmetric and definite): (m,)."""
    if conductance.ndim == 1:
        return np.asarray(np.isfinite(conductance) & (conductance > 0), dtype=np.bool_)
    (xx, xy), (yx, yy) = np.moveaxis(conductance, (-2, -1), (0, 1))
    with np.errstate(invalid="ignore", over="ignore"):
        alike = np.abs(xy - yx) <= 1e-12 * np.sqrt(np.abs(xx * yy))
        definite = np.isfinite(xx + yy) & alike & (xx > 0) & (xx * yy > xy**2)
    return np.asarray(definite.all(axis=1), dtype=np.bool_)


def check_values(name: str, values: Array, shape: tuple[int, ...]) -> Array:
    """Return conductances or contact impedances unchanged.

    NumericsError if they have another shape, or one is not a positive finite number, naming the first of these.
    """
    if values.shape != shape:
        raise NumericsError(
            f"{name} has shape {values.shape}; one value for each of {shape[0]} is needed",
            remedy=f"give an array of shape {shape}",
        )
    bad_indices = np.flatnonzero(~conducts(values))
    if bad_indices.size:
        direction = ", in every direction" if values.ndim > 1 else ""
        raise NumericsError(
            f"{name} {bad_indices[0]} is {values[bad_indices[0]].tolist()} (one of {bad_indices.size} such);"
            f" it must be a positive finite number{direction}",
            remedy=_NOTHING.get(name, ""),
        )
    return values
