"""Shape functions of triangles and their edges, of first and second order, in barycentric coordinates.

Nodes of a triangle are its corners, then the middles of the edges from corner j to j + 1; those of an edge its ends,
then its middle.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """What an element needs to know of its shape functions, at points where it integrates.

    Parameters
    ----------
    points : (q, 3) barycentric coordinates of the points inside a triangle, all of one weight.
    slopes : (q, k, 2) derivatives of the triangle's functions along its first and its third edge turned round, that
        is by the second and by the third barycentric coordinate.
    edge_weights : (g,) of the points along an edge, with sum 1.
    edge_values, edge_slopes : (g, b) functions of the edge and their derivatives from end to end.
    """

    points: Array
    slopes: Array
    edge_weights: Array
    edge_values: Array
    edge_slopes: Array


def _linear() -> Shapes:
    points = np.full((1, 3), 1 / 3)
    along, weights = _gauss(2)
    values = np.column_stack([1 - along, along])
    return Shapes(points, _free(np.eye(3)[None]), weights, values, np.tile([-1.0, 1.0], (2, 1)))


def _quadratic() -> Shapes:
    """Three points are exact for the stiffness of straight elements, and enough for bent ones (Ciarlet 1978)."""
    points = (np.eye(3) * 3 + 1) / 6
    slopes = np.zeros((3, 6, 3))
    for corner in range(3):
        following = (corner + 1) % 3
        slopes[:, corner, corner] = 4 * points[:, corner] - 1
        slopes[:, 3 + corner, corner] = 4 * points[:, following]
        slopes[:, 3 + corner, following] = 4 * points[:, corner]
    s, weights = _gauss(4)
    values = np.column_stack([(1 - s) * (1 - 2 * s), s * (2 * s - 1), 4 * s * (1 - s)])
    return Shapes(points, _free(slopes), weights, values, np.column_stack([4 * s - 3, 4 * s - 1, 4 - 8 * s]))


def _free(slopes: Array) -> Array:
    """Derivatives by the coordinates that are free once their sum is one."""
    return slopes[..., 1:] - slopes[..., :1]


def _gauss(count: int) -> tuple[Array, Array]:
    points, weights = np.polynomial.legendre.leggauss(count)
    return (points + 1) / 2, weights / 2


#: by order
SHAPES: Final = {1: _linear(), 2: _quadratic()}
