"""Hard cases of masks, blobs and outlines: ties, single elements, plateaus, empty and extreme images."""

from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.imaging.blobs import find_blobs_by_mask, noise_floor, percentage_mask, subtract_noise_floor
from cbsr_qa.eit.imaging.contours import contour_regions
from cbsr_qa.eit.imaging.rasters import Raster, find_regions, pixel_image, split_touching
from cbsr_qa.eit.imaging.shape import greit_figures
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.exact import largest_relative_error, relative_error

AREA: Final = Area("imaging")
_TRIANGLE: Final = "area, weight and centre of the triangle"
_SIDE: Final = 12  # pixels of the square images


def single_element(scale: float) -> Answer:
    """Area, weight and centre of a blob of one element, of an image of this size."""
    image = _mesh_image(np.zeros((_SIDE, _SIDE)))
    image.values[90] = scale
    (blob,) = find_blobs_by_mask(image, (0.85,))[0]
    corners = image.mesh.corners_mm[90]
    values = [blob.area_mm2, blob.weight / scale, *blob.centre_mm().tolist()]
    digits = max(1.0, float(np.finfo(np.float64).tiny) / scale)  # a subnormal number has fewer digits
    error = largest_relative_error(values, [0.5, 0.5, corners[:, 0].mean(), corners[:, 1].mean()])
    return answer_from_condition(error, digits)


def empty_image(value: float) -> Answer:
    """Regions found where nothing was sensed."""
    values = np.full((_SIDE, _SIDE), value)
    image = _mesh_image(values)
    count = len(find_blobs_by_mask(image, (0.85,))[0]) + len(contour_regions(image, 0.85))
    count += len(find_regions(Raster(values, 1.0, (0.0, 0.0)), 0.85))
    count += greit_figures(image, RoundFootprint(5.5, 5.5, 3.0)) is not None
    return Answer(float(count), 0.0, unit="regions")


def outline_error(image: Image) -> tuple[float, int]:
    """Area by Green's theorem along the outline of the one region at half, against its pieces; and its sides."""
    (region,) = contour_regions(image, 0.5)
    start, end = region.rim_mm()
    near, far = start - start[0], end - start[0]
    outlined = float((near[:, 0] * far[:, 1] - near[:, 1] * far[:, 0]).sum()) / 2
    return relative_error(outlined, region.area_mm2), len(start)


def _mesh_image(values: Array) -> Image:
    return pixel_image(Raster(values, 1.0, (0.0, 0.0)))


@AREA.against("whole numbers compared as fractions")
def values_on_the_mask() -> Answer:
    """A mask at p % of the maximum is a comparison, and values that lie exactly on it round to either side."""
    steps = np.arange(1, 1001)
    wrong_count = 0
    for scale in (0.1, 1 / 3, np.pi, 1e-9, 7e8):
        for percent in (25, 50, 75, 85):
            is_kept = percentage_mask(steps * scale / 1000, percent / 100)
            wrong_count += int((is_kept != (100 * steps >= percent * 1000)).sum())
    return Answer(float(wrong_count), 0.0, unit="elements", note="of 20 000 compared")


@AREA.against("the whole sheet is in the set: resolution 1")
def values_on_the_quarter_of_greit() -> Answer:
    """Elements at exactly a quarter of the maximum count for GREIT; 0.25 × (3 × 0.1) rounds to more than 0.075."""
    values = np.full((_SIDE, _SIDE), 0.075)
    values[3:-3, 3:-3] = 0.1 * 3
    figures = greit_figures(_mesh_image(values), RoundFootprint(5.5, 5.5, 3.0))
    resolution = 0.0 if figures is None else figures.resolution
    return answer_from_condition(abs(resolution - 1.0), 1.0)


@AREA.against("one region of all pixels")
def flat_raster_parted() -> Answer:
    """Where all pixels are equal there is no peak that a watershed could start from."""
    regions = split_touching(Raster(np.full((_SIDE, _SIDE), 0.3), 1.0, (0.0, 0.0)), 0.85, 4.0)
    pixels = sum(int(region.pixels.sum()) for region in regions)
    return Answer(float(abs(pixels - _SIDE**2) + abs(len(regions) - 1)), 0.0, unit="pixels and regions")


@AREA.against("the whole sheet and its middle")
def flat_image_contour() -> Answer:
    """A field without slope has no place where it passes a level."""
    regions = contour_regions(_mesh_image(np.full((_SIDE, _SIDE), 0.3)), 0.85)
    figures = [float(len(regions)), regions[0].area_mm2, *regions[0].centre_mm().tolist()]
    middle = (_SIDE - 1) / 2
    return answer_from_condition(largest_relative_error(figures, [1, _SIDE**2, middle, middle]), 1.0)


@AREA.against(_TRIANGLE)
def one_element_blob() -> Answer:
    """A blob of a single element."""
    return single_element(1.0)


@AREA.against(_TRIANGLE)
def one_element_blob_near_underflow() -> Answer:
    """A blob of a single element whose value is a subnormal number with four digits fewer."""
    return single_element(1e-312)


@AREA.against(_TRIANGLE)
def one_element_blob_near_overflow() -> Answer:
    """A blob of a single element whose value nearly is the largest number there is."""
    return single_element(1e307)


@AREA.against("area by Green's theorem along the outline = sum of the triangles")
def blob_on_the_rim() -> Answer:
    """A contour that meets the sheet's edge must be closed along it."""
    y, x = np.mgrid[:_SIDE, :_SIDE]
    image = _mesh_image(np.exp(-(x**2 + (y - 4.3) ** 2) / 12.0))
    return answer_from_condition(*outline_error(image))


@AREA.against("two loads, mirror images of each other")
def touching_blobs() -> Answer:
    """Two equal loads that touch in a corner, or whose slopes overlap: ties in every comparison."""
    squares = np.zeros((_SIDE, _SIDE))
    squares[2:5, 2:5] = squares[5:8, 5:8] = 1.0
    corners = len(find_blobs_by_mask(_mesh_image(squares), (0.85,))[0])
    y, x = np.mgrid[:40, :40]
    slopes = sum(np.exp(-((x - at) ** 2 + (y - 20) ** 2) / 18.0) for at in (15, 24))
    raster = Raster(np.asarray(slopes), 1.0, (0.0, 0.0))
    blobs = split_touching(raster, 0.25, 6.0)
    centre_error = abs(sum(float(part.centre_mm()[0]) for part in blobs) / 2 - 19.5) if len(blobs) == 2 else 40.0
    return answer_from_condition(abs(corners - 2) + abs(len(blobs) - 2) + centre_error, 20.0, unit="loads and pixels")


@AREA.against("no region")
def all_zero_image() -> Answer:
    """An image of zeros."""
    return empty_image(0.0)


@AREA.against("no region")
def all_negative_image() -> Answer:
    """An image of the wrong sign has a maximum, but not one to take a share of."""
    return empty_image(-1e-300)


@AREA.refuses(NumericsError)
def nan_image() -> None:
    """Every comparison with NaN is false: such an image looks empty."""
    percentage_mask(np.full(_SIDE**2, np.nan), 0.85)


@AREA.against("area of the diamond round one pixel")
def outline_far_from_the_origin() -> Answer:
    """The area of 0.05 mm² is a difference of products of places, a kilometre from the origin."""
    values = np.zeros((_SIDE, _SIDE))
    values[3, 3] = 1.0
    first = 1e6
    (region,) = find_regions(Raster(values, 1.0, (first, first)), 0.85)
    condition = first / 0.15  # of the outline's place to its extent
    return answer_from_condition(relative_error(region.area_mm2, 0.045), condition)


@AREA.against("the same image at the origin")
def centre_of_mass_far_from_the_origin() -> Answer:
    """A sheet with an origin a kilometre away."""
    y, x = np.mgrid[:_SIDE, :_SIDE]
    values = 1.0 + 0.01 * x + 0.02 * y
    offset_mm = 1e6
    near_centre_mm = find_blobs_by_mask(_mesh_image(values), (0.5,))[0][0].centre_mm()
    far_centre_mm = find_blobs_by_mask(pixel_image(Raster(values, 1.0, (offset_mm, offset_mm))), (0.5,))[0][
        0
    ].centre_mm()
    condition = offset_mm / float(near_centre_mm.min())
    return answer_from_condition(
        largest_relative_error(far_centre_mm - offset_mm, near_centre_mm.tolist()), condition
    )


@AREA.against("no element above it")
def noise_floor_of_identical_images() -> Answer:
    """Unloaded images without any noise: a floor that equals every value."""
    images = np.full((8, _SIDE**2), 0.1 + 0.2)
    remaining_image = subtract_noise_floor(images[0], noise_floor(images))
    return Answer(float(np.abs(remaining_image).max()), 0.0, unit="relative conductance change")
