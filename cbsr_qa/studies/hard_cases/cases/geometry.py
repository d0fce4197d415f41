"""Hard cases of areas and distances: needles, tangent circles, nearly coincident edges."""

from typing import Final

import mpmath
import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import PolygonFootprint, RoundFootprint, overlap_mm2
from cbsr_qa.domain.geometry.polygons import circle_overlap_mm2
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.imaging.rasters import Raster, find_regions
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.cases.imaging import outline_error
from cbsr_qa.studies.hard_cases.exact import (
    DIGITS,
    circle_overlap,
    largest_relative_error,
    polygon_area,
    relative_error,
)

AREA: Final = Area("imaging")
_TRIANGLE: Final = "area and centre of the triangle in fifty digits"
_CIRCLE: Final = "the same area by Green's theorem in fifty digits"
_RADIUS_MM: Final = 6.5


def needle(width_mm: float, first_mm: float) -> Answer:
    """Area and centre of a needle 100 mm long, so far from the origin."""
    corners = first_mm + np.array([[0.0, 0.0], [80.0, 60.0], [80.0 - 0.6 * width_mm, 60.0 + 0.8 * width_mm]])
    head = PolygonFootprint(corners)
    exact = polygon_area(corners)
    middle = corners.mean(axis=0)  # of a triangle
    # Rounding of the places, relative to the width.
    condition = float(np.abs(corners).max() / (2 * exact / 100))
    error = max(relative_error(head.area_mm2, exact), largest_relative_error(head.centre_mm, middle.tolist()))
    return answer_from_condition(error, condition)


def circle(corners: Array, centre: tuple[float, float]) -> Answer:
    """Area of a triangle inside the indenter's circle, as a share of the smaller of the two."""
    computed = float(circle_overlap_mm2(corners[None], centre, _RADIUS_MM)[0])
    exact = circle_overlap(corners, centre, _RADIUS_MM)
    with mpmath.workdps(DIGITS):
        smaller = min(polygon_area(corners), mpmath.pi * mpmath.mpf(_RADIUS_MM) ** 2)
        error = float(abs(mpmath.mpf(computed) - exact) / smaller)
        # A shift of all places by their rounding moves at most the whole outline's strip in or out.
        outline = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T).sum()
        reach = float(np.abs(corners - np.array(centre)).max())
        condition = float(min(outline, 2 * np.pi * _RADIUS_MM) * reach / smaller)
    return answer_from_condition(error, condition)


def rim_of(corners: int) -> Answer:
    """Mean squared distance of a polygon's sides from the circle through its corners."""
    half_angle = np.pi / corners
    angle = 2 * half_angle * np.arange(corners)
    rim = _RADIUS_MM * np.column_stack([np.cos(angle), np.sin(angle)])
    computed = RoundFootprint(0.0, 0.0, _RADIUS_MM).integrate_distance2_mm3(rim, np.roll(rim, -1, axis=0)).sum()
    with mpmath.workdps(DIGITS):
        r, turn = mpmath.mpf(_RADIUS_MM), mpmath.pi / corners
        height, reach = r * mpmath.cos(turn), r * mpmath.sin(turn)
        # ∫ (√(u² + h²) − r)² du along one side, whose ends are on the circle.
        bent = reach * r + height**2 * mpmath.asinh(reach / height)
        truth = corners * 2 * (reach**3 / 3 + (height**2 + r**2) * reach - r * bent)
        condition = float(2 * r / (r - height))  # of the distance from the circle
    return answer_from_condition(relative_error(float(computed), truth), condition)


def _triangle(x: float, y: float = 0.0, *, long: float = 3.0) -> Array:
    """A tip at (x, y) that points to the left."""
    return np.array([[x, y], [x + long, y - long / 2], [x + long, y + long / 2]])


@AREA.against(_TRIANGLE)
def needle_of_a_nanometre() -> Answer:
    """A head 100 mm long and a millionth of a millimetre wide."""
    return needle(1e-6, 0.0)


@AREA.against(_TRIANGLE)
def needle_far_from_the_origin() -> Answer:
    """The same a kilometre away, a thousandth wide: products of places are 1e13 times its area."""
    return needle(1e-3, 1e6)


@AREA.against(_CIRCLE)
def side_tangent_to_the_circle() -> Answer:
    """A side that touches the circle: whether it passes through is a square root of rounding."""
    return circle(np.array([[-9.0, _RADIUS_MM], [9.0, _RADIUS_MM], [0.0, 12.0]]), (0.0, 0.0))


@AREA.against(_CIRCLE)
def side_within_1e_8_of_the_circle() -> Answer:
    """A side that cuts a segment of 1e-8 mm off the circle."""
    return circle(np.array([[-9.0, _RADIUS_MM - 1e-8], [9.0, _RADIUS_MM - 1e-8], [0.0, 12.0]]), (0.0, 0.0))


@AREA.against(_CIRCLE)
def tip_within_1e_8_of_the_circle() -> Answer:
    """A corner that reaches 1e-8 mm into the circle."""
    return circle(_triangle(_RADIUS_MM - 1e-8), (0.0, 0.0))


@AREA.against(_CIRCLE)
def corner_at_the_centre() -> Answer:
    """A corner 1e-12 mm from the centre, from which sectors are counted: its direction is rounding."""
    return circle(_triangle(1e-12, 1e-12), (0.0, 0.0))


@AREA.against(_CIRCLE)
def circle_within_a_huge_triangle() -> Answer:
    """A triangle of a kilometre round a circle of 13 mm."""
    return circle(1e6 * np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]]), (0.0, 0.0))


@AREA.against(_CIRCLE)
def circle_far_from_the_origin() -> Answer:
    """Circle and triangle a kilometre from the origin."""
    return circle(1e6 + _triangle(2.0), (1e6 + 1.0, 1e6 - 1.0))


@AREA.against("the integral along a side in closed form and fifty digits")
def rim_at_the_indenter() -> Answer:
    """The outline of a blob that is the indenter's to a millionth: its deviation is a difference of cubes."""
    return rim_of(5000)


@AREA.against("area by Green's theorem along the outline = sum of the pieces")
def contour_over_needles() -> Answer:
    """Elements a millionth as wide as long."""
    columns, width = 40, 1e-6
    x = np.repeat(np.linspace(0.0, 1.0, columns + 1), 2)
    nodes = np.column_stack([x, np.tile([0.0, width], columns + 1)])
    lower = 2 * np.arange(columns)
    elements = np.concatenate(
        [np.column_stack([lower, lower + 2, lower + 3]), np.column_stack([lower, lower + 3, lower + 1])]
    )
    mesh = Mesh(nodes, elements)
    error, _ = outline_error(Image(mesh, mesh.centroids_mm[:, 0] + 0.25))
    return answer_from_condition(error, 1 / width)


@AREA.against("area of the diamond round one pixel, wherever it is")
def pixels_in_the_corners() -> Answer:
    """A pixel in the corner of a raster, where its outline needs neighbours that are not there."""
    areas = []
    for row, column in ((0, 0), (4, 4), (0, 8), (8, 0), (8, 8)):
        values = np.zeros((9, 9))
        values[row, column] = 1.0
        areas += [region.area_mm2 for region in find_regions(Raster(values, 1.0, (0.0, 0.0)), 0.85)]
    return answer_from_condition(largest_relative_error(areas, [mpmath.mpf("0.045")] * 5), 8 / 0.15)


@AREA.refuses(NumericsError)
def head_without_area() -> None:
    """A head whose corners lie in a line."""
    overlap_mm2(PolygonFootprint(np.array([[0.0, 0.0], [1.0, 0.1], [2.0, 0.2], [1.0, 0.1]])), np.zeros((1, 3, 2)))
