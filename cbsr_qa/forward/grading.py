"""How large the elements of a sheet's mesh are, from place to place."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Lengths = NDArray[np.float64]
Size = Callable[[Points], Lengths]

FINEST: Final = 1 / 16  # edge length at a pin's rim or an arc's end, relative to the sheet's
EDGES_PER_PIN: Final = 12  # at least so many edges round a pin
EDGES_PER_ARC: Final = 10  # and along an arc
SMOOTHING: Final = 10  # passes
_STEEPEST = 0.45  # growth of the edge length per distance from an electrode; more makes thin triangles
_REACH = 0.13  # of the radius: how far the refinement reaches, so that a family of meshes refines everywhere alike


def growth(size: float, radius: float) -> float:
    """Growth of the edge length per distance from where it is finest."""
    return min(_STEEPEST, size / (_REACH * radius))


def graded(size: float, finest: float, radius: float, distance: Callable[[Points], Lengths]) -> Size:
    """Edge lengths that grow from ``finest`` to ``size`` with a distance."""
    slope = growth(size, radius)

    def sizes(points: Points) -> Lengths:
        return np.minimum(size, finest + slope * np.maximum(distance(points), 0))

    return sizes


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
