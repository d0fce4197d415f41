"""Several loads at once: which region belongs to which load, and what was merged, missed or made up."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.footprints import Footprint
from cbsr_qa.domain.image import Region
from cbsr_qa.domain.polygons import inside_edges


@dataclass(frozen=True, slots=True)
class Assignment:
    """Which region belongs to which load.

    Parameters
    ----------
    region_of : for each load the index of its region; None where it has none of its own.
    merged_with : for each load the index of the load whose region it shares; None where it shares none.
    false : indices of the regions that belong to no load.
    """

    region_of: tuple[int | None, ...]
    merged_with: tuple[int | None, ...]
    false: tuple[int, ...]

    @property
    def missed(self) -> tuple[int, ...]:
        """Loads with neither a region of their own nor a share in another's."""
        pairs = zip(self.region_of, self.merged_with, strict=True)
        return tuple(load for load, (own, shared) in enumerate(pairs) if own is None and shared is None)

    @property
    def merged(self) -> tuple[int, ...]:
        """Loads that share the region of another."""
        return tuple(load for load, shared in enumerate(self.merged_with) if shared is not None)

    @property
    def apart(self) -> bool:
        """Whether every load has a region of its own that no other shares."""
        return not self.merged and not self.missed

    def fate(self, load: int) -> str:
        """Say what became of a load: ``"apart"``, ``"merged"`` (the one that owns the region too) or ``"missed"``."""
        if load in self.missed:
            return "missed"
        return "merged" if load in self.merged or load in self.merged_with else "apart"


def assign_regions(regions: Sequence[Region], loads: Sequence[Footprint], *, gate_mm: float) -> Assignment:
    """Assign regions to loads so that the sum over the loads of min(distance, gate) is the least there is.

    The distance is that of the region's centre of mass from the load's centre; a load without region counts as one
    at the gate (the cut-off distance of OSPA, Schuhmacher, Vo & Vo 2008). A region can belong to a load that is
    within the gate, or whose centre it covers. A load left without a region of its own is *merged* with the owner of
    one that could have been its own, and *missed* where there is none.

    Parameters
    ----------
    gate_mm : beyond this distance a region says nothing about a load; the diameter of the head is a fair choice.

    Raises
    ------
    NumericsError
        If the gate is not a positive number.
    """
    if not 0 < gate_mm < float("inf"):
        raise NumericsError(f"a gate of {gate_mm} mm assigns nothing", remedy="take the diameter of the head")
    distance, covered = _relations(regions, loads)
    possible = covered | (distance <= gate_mm)
    # A column of its own lets every load stay without region; of two equal costs, a region is better than none.
    nobody = np.where(np.eye(len(loads), dtype=np.bool_), gate_mm * (1 + 1e-9), np.inf)
    costs = np.hstack([np.where(possible, np.minimum(distance, gate_mm), np.inf), nobody])
    columns = linear_sum_assignment(costs)[1].tolist()
    region_of = tuple(column if column < len(regions) else None for column in columns)
    owner = {region: load for load, region in enumerate(region_of) if region is not None}
    merged_with = tuple(
        min((k for k in owner if possible[load, k]), key=lambda k: float(distance[load, k]), default=None)
        if own is None
        else None
        for load, own in enumerate(region_of)
    )
    return Assignment(
        region_of,
        tuple(None if k is None else owner[k] for k in merged_with),
        tuple(k for k in range(len(regions)) if k not in owner),
    )


def _relations(
    regions: Sequence[Region], loads: Sequence[Footprint]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Distances of the regions' centres of mass from the loads' centres, and whether they cover them."""
    pressed = np.array([load.centre_mm for load in loads]).reshape(-1, 2)
    distance = np.empty((len(loads), len(regions)))
    covered = np.empty_like(distance, dtype=np.bool_)
    for number, region in enumerate(regions):
        distance[:, number] = np.hypot(*(pressed - region.centre_mm()).T)
        covered[:, number] = inside_edges(pressed, *region.rim_mm())
    return distance, covered
