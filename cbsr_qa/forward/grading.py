"""How large the elements of a sheet's mesh are, from place to place."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Lengths = NDArray[np.float64]
Size = Callable[[Points], Lengths]
#: (least edge length, distances from where it is) → edge lengths
Grade = Callable[[float, Lengths], Lengths]

FINEST: Final = 1 / 16  # edge length at a pin's rim or an arc's end, relative to the sheet's
EDGES_PER_PIN: Final = 12  # at least so many edges round a pin
EDGES_PER_ARC: Final = 10  # and along an arc
FEWEST_SMOOTHLY: Final = 4  # edges along an arc, for elements of second order
SMOOTHING: Final = 10  # passes
_STEEPEST = 0.45  # growth of the edge length per distance from an electrode; more makes thin triangles
# For the second order: with a size of 0.12 radii all readings of a disc with 16 arcs err by 1e-4, in 7000 unknowns.
_SMOOTH_SIZE = 0.12
_SMOOTH_FACTOR = 0.17
_SMOOTH_POWER = 0.6
_SMOOTH_STEEPEST = 0.6
_REACH = 0.13  # of the radius: how far the refinement reaches, so that a family of meshes refines everywhere alike


def growth(size: float, radius: float) -> float:
    """Growth of the edge length per distance from where it is finest."""
    return min(_STEEPEST, size / (_REACH * radius))


def graded(size: float, finest: float, radius: float, distance: Callable[[Points], Lengths]) -> Size:
    """Edge lengths that grow from ``finest`` to ``size`` with a distance."""
    lengths = plain_lengths(size, radius)
    return lambda points: lengths(finest, distance(points))


def plain_lengths(size: float, radius: float) -> Grade:
    """Edge lengths by their least and the distance from there."""
    slope = growth(size, radius)
    return lambda finest, away: np.minimum(size, finest + slope * np.maximum(away, 0))


def graded_smoothly(size: float, finest: float, radius: float, distance: Callable[[Points], Lengths]) -> Size:
    """Edge lengths for elements of second order, which all err alike under a singularity in ``distance`` 0.

    Where a field goes as r log r an element of second order errs by (h/r)⁴ r² in energy, and there are r dr/h² of
    them: both together are least for h ∝ r^(2/3). The power was then measured on discs with arcs. Readings converge
    with the fourth order of ``size``, whatever the contact impedance.
    """
    lengths = smooth_lengths(size, radius)
    return lambda points: lengths(finest, distance(points))


def smooth_lengths(size: float, radius: float, power: float = _SMOOTH_POWER) -> Grade:
    """Edge lengths for elements of second order by their least and the distance from there.

    Parameters
    ----------
    power : of the distance; 1 − λ/3 at a corner where the field goes as r^λ.
    """
    scale = size / (_SMOOTH_SIZE * radius)
    slope = _SMOOTH_STEEPEST * min(1.0, scale)

    def lengths(finest: float, distance: Lengths) -> Lengths:
        away = np.maximum(distance, 0)
        far = np.minimum(size, _SMOOTH_FACTOR * scale * radius * (away / radius) ** power)
        return np.maximum(finest, np.minimum(far, finest + slope * away))

    return lengths


def finest_at_corner(size: float, radius: float, power: float) -> float:
    """Edge length at a re-entrant corner, for elements of second order: where its power of r meets the slope."""
    scale = size / (_SMOOTH_SIZE * radius)
    slope = _SMOOTH_STEEPEST * min(1.0, scale)
    return float(slope * radius * min(1.0, _SMOOTH_FACTOR * scale / slope) ** (1 / (1 - power)))


def finest_smoothly(size: float, radius: float, length: float) -> float:
    """Edge length at the ends of an electrode of some length, for elements of second order."""
    scale = size / (_SMOOTH_SIZE * radius)
    return float(min(0.012 * scale ** (1 / (1 - _SMOOTH_POWER)), 0.1)) * length


def edges_round_pin_smoothly(size: float, radius: float) -> int:
    """Edges round a pin, for elements of second order."""
    return max(6, int(np.ceil(8 * _SMOOTH_SIZE * radius / size - 1e-9)))


def finest_of_arc(size: float, radius: float, length: float) -> float:
    """Edge length at an arc's ends, small enough that it takes its least number of edges."""
    slope = growth(size, radius)
    return min(size * FINEST, slope * length / 2 / float(np.expm1(slope * EDGES_PER_ARC / 2)))


def spread(density: Lengths, places: Lengths, *, at_least: int) -> Lengths:
    """Places between the first and the last, both included, that share out the integral of a density evenly.

    Parameters
    ----------
    density : (n,) edges per length, at (n,) evenly spaced ``places``.
    at_least : number of stretches.
    """
    total = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2) * (places[1] - places[0])])
    count = max(at_least, int(np.ceil(total[-1])))
    chosen: Lengths = np.interp(np.arange(count + 1) / count * total[-1], total, places)
    return chosen
