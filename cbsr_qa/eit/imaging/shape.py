"""The paper's spatial metrics of a sensed region against the indenter (Eqs 4 to 6), and bands of the overlap.

Figures of merit of Adler et al. 2009 (Physiol. Meas. 30 S35), area-weighted and exact on a mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import Footprint, RoundFootprint, overlap_mm2
from cbsr_qa.domain.imaging import Blob, Image, OverlapBand, Region
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.eit.imaging.blobs import threshold


@dataclass(frozen=True, slots=True)
class SpatialFigures:
    """Spatial metrics of one region against one indenter.

    Parameters
    ----------
    error_mm : E_CoM, see :func:`centre_of_mass_error_mm`.
    overlap_percent : A_OL, see :func:`area_overlap_percent`.
    deviation_mm2 : SD, see :func:`shape_deviation_mm2`.
    area_ratio : A_b/A_FA.
    """

    error_mm: float
    overlap_percent: float
    deviation_mm2: float
    area_ratio: float


def spatial_figures(
    regions: Sequence[Region | None], indenter: Footprint, *, clipping: str = "exact", perimeter: str = "length"
) -> tuple[SpatialFigures | None, ...]:
    """Return the figures of several regions in one pass over all perimeters; None for a missing region.

    ``clipping``, ``perimeter``: modes of :func:`area_overlap_percent` and :func:`shape_deviation_mm2`; raises as
    these do.
    """
    present_regions = [region for region in regions if region is not None]
    if not present_regions:
        return (None,) * len(regions)
    rims = [region.rim_mm() for region in present_regions]
    overlaps = _overlaps_percent(present_regions, rims, indenter, clipping)
    deviations = _deviations_mm2(present_regions, rims, indenter, perimeter)
    figures = iter(
        SpatialFigures(
            centre_of_mass_error_mm(region, indenter), overlap, deviation, region.area_mm2 / indenter.area_mm2
        )
        for region, overlap, deviation in zip(present_regions, overlaps, deviations, strict=True)
    )
    return tuple(None if region is None else next(figures) for region in regions)


def centre_of_mass_error_mm(region: Region, indenter: Footprint) -> float:
    """Return E_CoM = ‖M − F‖, the distance of the region's centre of mass from the indenter's centre [mm].

    Paper Eq 4 with area weights. F of a non-round indenter is the centre of mass of its area.
    """
    return float(np.hypot(*(region.centre_mm() - np.array(indenter.centre_mm))))


def area_overlap_percent(region: Region, indenter: Footprint, mode: str = "exact") -> float:
    """Return A_OL = 50 (A_in/A_FA + A_in/A_b), the mutual overlap of region and indenter [%] (paper Eq 5).

    Parameters
    ----------
    mode : ``"exact"`` clips the region against the indenter's outline; ``"centroid"`` counts elements whose centroid
        lies inside, as the paper does, and depends on the mesh.

    Raises
    ------
    NumericsError
        If the mode is unknown, or centroids are requested for a region without elements.
    """
    return _overlaps_percent([region], [region.rim_mm()], indenter, mode)[0]


def shape_deviation_mm2(region: Region, indenter: Footprint, mode: str = "length") -> float:
    """Return SD, the mean squared distance of the region's perimeter from the indenter's outline [mm²] (paper Eq 6).

    Parameters
    ----------
    mode : ``"length"`` integrates along the perimeter's edges, exactly for a round indenter and to 1e-9 of its area
        for another; ``"nodes"`` is the paper's mean over perimeter nodes.

    Raises
    ------
    NumericsError
        If the mode is unknown, or nodes are requested for a region without elements.
    """
    return _deviations_mm2([region], [region.rim_mm()], indenter, mode)[0]


def _overlaps_percent(
    regions: Sequence[Region], rims: Sequence[tuple[Array, Array]], indenter: Footprint, mode: str
) -> list[float]:
    if mode == "exact":
        # Green's theorem: the overlap depends only on the region's perimeter.
        start, end, first_edges = _join_rims(rims)
        overlaps_mm2 = np.maximum(np.add.reduceat(indenter.area_under_edges_mm2(start, end), first_edges), 0.0)
    elif mode == "centroid":
        blobs = [_require_blob(region, "clipping by centroids") for region in regions]
        areas_mm2 = [blob.image.mesh.areas_mm2[blob.elements] for blob in blobs]
        inside_masks = [indenter.contains(blob.image.mesh.centroids_mm[blob.elements]) for blob in blobs]
        overlaps_mm2 = np.array([float(areas @ mask) for areas, mask in zip(areas_mm2, inside_masks, strict=True)])
    else:
        raise NumericsError(f"unknown clipping mode {mode!r}", remedy="use 'exact' or 'centroid'")
    area = np.array([region.area_mm2 for region in regions])
    percent: list[float] = (50.0 * overlaps_mm2 * (1 / indenter.area_mm2 + 1 / area)).tolist()
    return percent


def _deviations_mm2(
    regions: Sequence[Region], rims: Sequence[tuple[Array, Array]], indenter: Footprint, mode: str
) -> list[float]:
    if mode == "nodes":
        blobs = [_require_blob(region, "a mean over nodes") for region in regions]
        nodes = [blob.image.mesh.nodes_mm[np.unique(blob.rim)] for blob in blobs]
        return [float(np.mean(indenter.distance_mm(places) ** 2)) for places in nodes]
    if mode != "length":
        raise NumericsError(f"unknown perimeter mode {mode!r}", remedy="use 'length' or 'nodes'")
    start, end, first_edges = _join_rims(rims)
    edge = end - start
    length = np.sqrt(edge[:, 0] ** 2 + edge[:, 1] ** 2)
    mean = np.add.reduceat(indenter.integrate_distance2_mm3(start, end), first_edges) / np.add.reduceat(
        length, first_edges
    )
    deviations: list[float] = mean.tolist()
    return deviations


def _join_rims(rims: Sequence[tuple[Array, Array]]) -> tuple[Array, Array, Indices]:
    start, end = (np.concatenate(parts) for parts in zip(*rims, strict=True))
    return start, end, np.cumsum([0, *(len(rim[0]) for rim in rims[:-1])])


def _require_blob(region: Region, what: str) -> Blob:
    if not isinstance(region, Blob):
        raise NumericsError(f"{what} needs a region of whole elements", remedy='set outline = "elements"')
    return region


#: The paper's scale, [lower, upper) percent. Clipping can round a full overlap to just above 100.
DEFAULT_BANDS: Final = (
    OverlapBand("likely poor", 0.0, 50.0),
    OverlapBand("ok", 50.0, 70.0),
    OverlapBand("good", 70.0, 100.0),
)

#: Lowest and highest A_b/A_FA for which a band counts.
DEFAULT_SIZE_RATIO: Final = (1 / 3, 3.0)

#: Grade of a blob whose size makes its overlap meaningless: one over the whole sheet, or one speck, scores 50 %.
WRONG_SIZE: Final = "likely poor: size"


def overlap_grade(
    overlap_percent: float,
    area_ratio: float,
    *,
    bands: Sequence[OverlapBand] = DEFAULT_BANDS,
    size_ratio: tuple[float, float] = DEFAULT_SIZE_RATIO,
) -> str:
    """Name the band of an area overlap [%], ``"likely poor: size"`` for an area ratio out of range, or ``"no band"``.

    Parameters
    ----------
    area_ratio : A_b/A_FA.
    bands : [lower, upper) each; the highest band includes its upper end.
    size_ratio : both ends inclusive.
    """
    lowest, highest = size_ratio
    if not lowest <= area_ratio <= highest:
        return WRONG_SIZE
    top = max(band.upper for band in bands)
    for band in bands:
        if band.lower <= overlap_percent < band.upper or (band.upper == top and overlap_percent >= top):
            return band.name
    return "no band"


#: The set q contains values above this share of the maximum (a quarter, as in Adler et al.).
QUARTER = 0.25


@dataclass(frozen=True, slots=True)
class GreitFigures:
    """Figures of one image of one target.

    Parameters
    ----------
    amplitude_response : AR, integral of the image over that of the target; None if its contrast is unknown.
    position_error_mm : PE = r_t − r_q, positive where the image is nearer to the sheet's centre than the target.
    resolution : RES = √(A_q/A_0), of the area of the sheet.
    shape_deformation : SD, share of q outside a circle of its area about its centre.
    ringing : RNG, integral of the opposite sign outside that circle over the integral within it; None if that is not
        positive (a set q in several pieces, with a gap at the centre).
    """

    amplitude_response: float | None
    position_error_mm: float
    resolution: float
    shape_deformation: float
    ringing: float | None


def greit_figures(image: Image, target: Footprint, *, contrast: float | None = None) -> GreitFigures | None:
    """Measure an image of one target; None for an image without a positive element.

    The set q and the circle are taken over the whole image (Adler et al. 2009). Elements that the circle cuts count
    with the share it cuts off. The centre of q is that of its area.

    Parameters
    ----------
    image : image with a positive target; nothing is subtracted from it, since ringing is negative.
    contrast : relative conductance change of the target, of the sign of the image; for AR.

    Raises
    ------
    NumericsError
        If the contrast is not positive.
    """
    if contrast is not None and not contrast > 0:
        raise NumericsError(f"contrast is {contrast:g}; it must be positive", remedy="invert image and contrast")
    mesh, values = image.mesh, image.values
    if values.max() <= 0:
        return None
    kept_mask = values >= threshold(values, QUARTER)
    area = float(mesh.areas_mm2[kept_mask].sum())
    centre = mesh.areas_mm2[kept_mask] @ mesh.centroids_mm[kept_mask] / area
    inside_mm2 = overlap_mm2(
        RoundFootprint(float(centre[0]), float(centre[1]), np.sqrt(area / np.pi)), mesh.corners_mm
    )
    outside_mm2 = np.maximum(mesh.areas_mm2 - inside_mm2, 0.0)
    inside_integral = float(values @ inside_mm2)
    integral = float(values @ mesh.areas_mm2)
    return GreitFigures(
        amplitude_response=None if contrast is None else integral / (contrast * target.area_mm2),
        position_error_mm=float(np.hypot(*target.centre_mm) - np.hypot(*centre)),
        resolution=float(np.sqrt(area / mesh.areas_mm2.sum())),
        shape_deformation=float(outside_mm2[kept_mask].sum()) / area,
        ringing=float(np.maximum(-values, 0.0) @ outside_mm2) / inside_integral if inside_integral > 0 else None,
    )
