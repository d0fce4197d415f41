"""Several simultaneous loads: regions assigned to loads, touching loads separated, two-touch resolution."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import Footprint, overlap_mm2
from cbsr_qa.domain.geometry.polygons import inside_edges
from cbsr_qa.domain.imaging import Blob, Image, ImagingProblem, PreparedReconstruction, Region
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.eit.imaging.blobs import find_blobs_by_mask
from cbsr_qa.eit.imaging.contours import contour_regions


def split_blobs(blobs: Sequence[Blob], prominence: float) -> tuple[Blob, ...]:
    """Split blobs with several peaks (watershed by flooding, Vincent & Soille 1991, on the mesh's elements).

    A peak counts if every path to a higher one descends by more than the prominence.

    Parameters
    ----------
    prominence : a share of the largest value of all blobs, in (0, 1).

    Returns
    -------
    Heaviest first; blobs with one peak are unchanged.

    Raises
    ------
    NumericsError
        If the prominence is outside (0, 1).
    """
    if not 0 < prominence < 1:
        raise NumericsError(
            f"prominence is {prominence:g}; allowed: above 0, below 1", remedy="as a fraction of the peak, e.g. 0.05"
        )
    if not blobs:
        return ()
    depth = prominence * max(float(blob.image.values[blob.elements].max()) for blob in blobs)
    parts = [part for blob in blobs for part in _split_blob(blob, depth)]
    return tuple(sorted(parts, key=lambda part: (-part.weight, int(part.elements[0]))))


def _split_blob(blob: Blob, depth: float) -> list[Blob]:
    basin = _flood_basins(blob.image.values[blob.elements], _neighbours(blob), depth)
    numbers = np.unique(basin)
    if len(numbers) == 1:
        return [blob]
    return [Blob(blob.image, blob.elements[basin == number]) for number in numbers]


def _neighbours(blob: Blob) -> list[list[int]]:
    number = np.full(len(blob.image.values), -1, dtype=np.int64)
    number[blob.elements] = np.arange(len(blob.elements))
    pairs = number[blob.image.mesh.neighbours]
    around: list[list[int]] = [[] for _ in blob.elements]
    for first, second in pairs[(pairs[:, 0] >= 0) & (pairs[:, 1] >= 0)].tolist():
        around[first].append(second)
        around[second].append(first)
    return around


def _flood_basins(values: Array, around: list[list[int]], depth: float) -> Indices:
    """Basin of every element, numbered by peak, as the level falls from the highest peak to the rim."""
    into = list(range(len(values)))  # a joined basin points to the basin it was joined to
    basin = np.full(len(values), -1, dtype=np.int64)

    def top(peak: int) -> int:
        while into[peak] != peak:
            peak = into[peak]
        return peak

    for element in np.argsort(-values, kind="stable").tolist():
        flooded_neighbours = sorted(
            (other for other in around[element] if basin[other] >= 0), key=lambda k: -values[k]
        )
        if not flooded_neighbours:
            basin[element] = element
            continue
        basin[element] = basin[flooded_neighbours[0]]
        peaks = sorted({top(int(basin[other])) for other in flooded_neighbours}, key=lambda k: (-values[k], k))
        for peak in peaks[1:]:
            if values[peak] - values[element] <= depth:
                into[peak] = peaks[0]
    return np.array([top(int(number)) for number in basin])


@dataclass(frozen=True, slots=True)
class Assignment:
    """Assignment of regions to loads.

    Parameters
    ----------
    region_of : index of each load's own region, or None.
    merged_with : index of the load whose region each load shares, or None.
    false : indices of the regions that belong to no load.
    """

    region_of: tuple[int | None, ...]
    merged_with: tuple[int | None, ...]
    false: tuple[int, ...]

    @property
    def missed(self) -> tuple[int, ...]:
        """Loads with neither their own region nor a share in another's."""
        pairs = zip(self.region_of, self.merged_with, strict=True)
        return tuple(load for load, (region, shared) in enumerate(pairs) if region is None and shared is None)

    @property
    def merged(self) -> tuple[int, ...]:
        """Loads that share the region of another."""
        return tuple(load for load, shared in enumerate(self.merged_with) if shared is not None)

    @property
    def apart(self) -> bool:
        """Whether every load has its own region, shared with no other load."""
        return not self.merged and not self.missed

    def name_outcome(self, load: int) -> str:
        """Fate of a load: ``"apart"``, ``"merged"`` (also for the load that owns the region) or ``"missed"``."""
        if load in self.missed:
            return "missed"
        return "merged" if load in self.merged or load in self.merged_with else "apart"


def assign_regions(regions: Sequence[Region], loads: Sequence[Footprint], *, gate_mm: float) -> Assignment:
    """Assign regions to loads so that the sum over the loads of min(distance, gate) is minimal.

    The distance is that of the region's centre of mass from the load's centre; a load without region counts as one at
    the gate (the cut-off distance of OSPA, Schuhmacher, Vo & Vo 2008). A region can belong to a load within the gate,
    or whose centre it covers. A load without its own region is *merged* with the owner of a region that could belong
    to it; without such a region it is *missed*.

    NumericsError if the gate is not a positive number.
    """
    if not 0 < gate_mm < float("inf"):
        raise NumericsError(f"gate is {gate_mm} mm; it must be positive", remedy="use the diameter of the head")
    distance, covered = _relations(regions, loads)
    possible_mask = covered | (distance <= gate_mm)
    # An extra column lets each load stay without a region; at equal cost a region is preferred.
    no_region_costs = np.where(np.eye(len(loads), dtype=np.bool_), gate_mm * (1 + 1e-9), np.inf)
    costs = np.hstack([np.where(possible_mask, np.minimum(distance, gate_mm), np.inf), no_region_costs])
    columns = linear_sum_assignment(costs)[1].tolist()
    region_of = tuple(column if column < len(regions) else None for column in columns)
    owner = {region: load for load, region in enumerate(region_of) if region is not None}
    merged_with = tuple(
        min((k for k in owner if possible_mask[load, k]), key=lambda k: float(distance[load, k]), default=None)
        if region_index is None
        else None
        for load, region_index in enumerate(region_of)
    )
    return Assignment(
        region_of,
        tuple(None if k is None else owner[k] for k in merged_with),
        tuple(k for k in range(len(regions)) if k not in owner),
    )


def _relations(regions: Sequence[Region], loads: Sequence[Footprint]) -> tuple[Array, Mask]:
    """Distances of the regions' centres of mass from the loads' centres, and whether they cover them."""
    pressed = np.array([load.centre_mm for load in loads]).reshape(-1, 2)
    distance = np.empty((len(loads), len(regions)))
    covered_mask = np.empty_like(distance, dtype=np.bool_)
    for number, region in enumerate(regions):
        distance[:, number] = np.hypot(*(pressed - region.centre_mm()).T)
        covered_mask[:, number] = inside_edges(pressed, *region.rim_mm())
    return distance, covered_mask


#: Mask under which a watershed separates two loads, and the depth of the valley between them, both of the maximum.
WATERSHED_MASK: Final = 0.25
WATERSHED_DEPTH: Final = 0.05


@dataclass(frozen=True, slots=True)
class TwoTouch:
    """Two equal loads, moved apart step by step.

    Parameters
    ----------
    separation_mm : smallest distance of their centres above which they are always resolved; None if not even at the
        largest.
    tried_mm : largest distance tried.
    step_mm : between distances.
    """

    separation_mm: float | None
    tried_mm: float
    step_mm: float


def two_touch_resolution(
    reconstruction: PreparedReconstruction,
    indenter: Indenter,
    *,
    mask: float | None = 0.85,
    furthest_mm: float | None = None,
    step_mm: float = 0.5,
) -> TwoTouch:
    """Move two equal loads apart along x, about the origin, until they stay resolved.

    They are resolved if ``assign_regions`` finds a region for each that is closer to it than
    to the other. Readings are those of the linearised model, without noise.

    Parameters
    ----------
    mask : level of the contours, as a share of the image's maximum; None for a watershed of the 25 % mask that
        separates peaks with a valley of 5 % between them.
    furthest_mm : largest distance of the centres; by default 0.8 of the sheet's radius.

    Raises
    ------
    NumericsError
        If the step is not positive, or the heads do not fit the distance.
    """
    problem = reconstruction.problem
    furthest_mm = 0.8 * problem.sensor_type.radius_mm if furthest_mm is None else furthest_mm
    direction = np.array([1.0, 0.0])
    width = float(np.ptp(indenter.footprint_at(0.0, 0.0).outline_mm() @ direction))
    if not (step_mm > 0 and width + step_mm <= furthest_mm):
        raise NumericsError(
            f"two heads {width:.3g} mm wide are not told apart up to {furthest_mm:.3g} mm in steps of {step_mm:g} mm",
            remedy="try larger distances, in positive steps",
        )
    distances_mm = step_mm * np.arange(np.ceil(width / step_mm), np.floor(furthest_mm / step_mm + 1e-9) + 1)
    # From the largest distance down, until they merge: smaller distances make no difference.
    resolved_mm = list(
        takewhile(lambda at: _pair(reconstruction, indenter, direction * at / 2, mask).apart, distances_mm[::-1])
    )
    return TwoTouch(float(resolved_mm[-1]) if resolved_mm else None, float(distances_mm[-1]), step_mm)


def loads_change(problem: ImagingProblem, loads: list[Footprint]) -> Array:
    """Return the readings' changes (m,) of equal loads of contrast 1, by the linearised model."""
    shares = [overlap_mm2(load, problem.mesh.corners_mm) / problem.mesh.areas_mm2 for load in loads]
    change: Array = problem.jacobian @ np.sum(shares, axis=0)
    return change


def _pair(reconstruction: PreparedReconstruction, indenter: Indenter, half: Array, mask: float | None) -> Assignment:
    loads = [indenter.footprint_at(float(x), float(y)) for x, y in (half, -half)]
    values = reconstruction.images(loads_change(reconstruction.problem, loads)[None])[0]
    image = Image(reconstruction.problem.mesh, np.maximum(values, 0.0))
    regions: tuple[Region, ...]
    if mask is None:
        regions = split_blobs(find_blobs_by_mask(image, (WATERSHED_MASK,))[0], WATERSHED_DEPTH)
    else:
        regions = contour_regions(image, mask)
    return assign_regions(regions, loads, gate_mm=float(np.hypot(*half)))
