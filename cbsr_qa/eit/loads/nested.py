"""Loads of nested outlines, for heads whose strain is not uniform."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain import Array, Indices, NumericsError
from cbsr_qa.domain.geometry import Footprint
from cbsr_qa.eit.forward import WHOLE, FiniteElements, elements_near, outline_normals, shares, slopes

_MARGIN: Final = 0.5  # how far a spread may leave [0, 1], as the best line through a step does


@dataclass(frozen=True, slots=True, eq=False)
class NestedCover:
    """Coverage of elements by nested outlines, at their integration points.

    Between one outline and the next smaller one lies a layer, in which the load is as strong as the weights of all
    outlines around it together.

    Parameters
    ----------
    elements : (k,) int64, rising, those any of them touches.
    layers : (k, q, j + 1) share of each layer about each integration point: that outside all outlines first, that
        inside the smallest last. They add up to one.
    levels : (j + 1,) relative strength in each layer, 0 outside.
    across : (k, q, 2) unit normal of the largest outline near each point.
    """

    elements: Indices
    layers: Array
    levels: Array
    across: Array

    def change(self, conductance: Array, relative: float | Array) -> Array:
        """Change of the conductance of each element.

        Along the outlines the layers' conductances add, across them the resistances, as
        :meth:`Cover.change <cbsr_qa.eit.forward.coverage.Cover.change>` has it for a single outline.

        Parameters
        ----------
        conductance : (e,) of all elements without the load [S].
        relative : change where the level is one, or (k,) one for each element.

        Returns
        -------
        (k, q, 2, 2) [S].

        Raises
        ------
        NumericsError
            If the change leaves no conductance somewhere, or is not finite.
        """
        relative = np.broadcast_to(np.asarray(relative, dtype=np.float64), self.elements.shape)
        raised = relative[:, None] * self.levels  # (k, j + 1)
        if not (np.isfinite(raised).all() and (raised > -1).all()):
            worst = relative[int(np.argmin(np.nan_to_num(raised.min(axis=1), nan=-np.inf)))]
            raise NumericsError(
                f"a relative change of {worst} leaves no positive conductance where a head presses"
                f" {self.levels.max():.3g} times as hard as on average",
                remedy="press less deep, or use a head with a more even pressure",
            )
        along = (self.layers @ raised[..., None])[..., 0]
        less = (self.layers @ (raised / (1 + raised))[..., None])[..., 0]  # of the resistance
        across = less / (1 - less)
        turned = (across - along)[..., None, None] * self.across[..., :, None] * self.across[..., None, :]
        change: Array = along[..., None, None] * np.eye(2) + turned
        return change * conductance[self.elements, None, None, None]


def nested_cover(
    elements: FiniteElements, largest: Footprint, centre_mm: tuple[float, float], sizes: Array, weights: Array
) -> NestedCover:
    """Area of each element covered by nested outlines of one shape; exact for any mesh.

    Parameters
    ----------
    elements : of either order; triangles are taken as straight.
    largest : the largest outline.
    centre_mm : about which the others are smaller.
    sizes : (j,) of the outlines over the largest's, at most 1, falling.
    weights : (j,) strength that each adds to all it surrounds.
    """
    mesh, centre = elements.mesh, np.array(centre_mm)
    near = elements_near(elements, largest)
    # A smaller outline covers of an element what the largest one covers of a larger element.
    grown = (mesh.corners_mm[near] - centre) / sizes[:, None, None, None] + centre
    share = np.minimum(shares(largest, grown.reshape(-1, 3, 2)).reshape(len(sizes), -1), 1.0)
    touched = share.max(axis=0) > 1e-12
    share, grown, near = share[:, touched], grown[:, touched], near[touched]
    points = elements.shapes.points
    spread = np.repeat(share[..., None], len(points), axis=-1)
    cut = (share > 1e-12) & (share < WHOLE)
    if elements.order == 2:
        line = slopes(largest, grown[cut], share[cut]) @ (points - 1 / 3).T
        spread[cut] += _held(line, share[cut])
    across = np.zeros((len(near), len(points), 2))
    some = cut.any(axis=0)
    across[some] = outline_normals(largest, mesh.corners_mm[near[some]], points)
    return NestedCover(near, _layers(spread), np.concatenate([[0.0], np.cumsum(weights)]), across)


def _layers(spread: Array) -> Array:
    """Shares of the layers (k, q, j + 1) from those of all that lies within each outline (j, k, q)."""
    within = np.concatenate([np.ones_like(spread[:1]), spread, np.zeros_like(spread[:1])])
    layers: Array = np.moveaxis(within[:-1] - within[1:], 0, -1)
    return np.ascontiguousarray(layers)


def _held(line: Array, share: Array) -> Array:
    """Deviations (c, q) from shares (c,), made smaller until their sum is at most so far outside [0, 1]."""
    with np.errstate(divide="ignore"):
        above, below = line.max(axis=1), -line.min(axis=1)
        room = np.minimum((1 + _MARGIN - share) / above, (share + _MARGIN) / below)
    held: Array = np.minimum(room, 1.0)[:, None] * line
    return held
