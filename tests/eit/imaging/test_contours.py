"""Regions bounded by a contour: exact for linear fields, of second order for smooth ones, closed where they end."""

from itertools import pairwise

import numpy as np
import pytest
from disc_meshes import disc_mesh, square_mesh
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.eit.imaging.blobs import find_blobs, find_blobs_by_mask, nearest_blob, percentage_mask
from cbsr_qa.eit.imaging.contours import contour_regions, field_regions, find_contours_by_mask, nodal_values
from cbsr_qa.eit.imaging.shape import SpatialFigures, spatial_figures
from cbsr_qa.eit.mesh.sheet import image_mesh

R = 6.5
MASKS = (0.25, 0.5, 0.75, 0.85)
SQUARE = square_mesh(6, size_mm=6.0)
values = hnp.arrays(np.float64, len(SQUARE.elements), elements=st.floats(0, 5, allow_subnormal=False))


def _sheet(cells: int, size_mm: float = 40.0) -> Mesh:
    """A square about the origin with its inner nodes displaced, so that no symmetry flatters an average."""
    mesh = square_mesh(cells, size_mm=size_mm)
    nodes = mesh.nodes_mm - size_mm / 2
    inner = (np.abs(nodes) < size_mm / 2 - 1e-9).all(axis=1)
    shift = np.random.default_rng(cells).uniform(-0.2, 0.2, nodes.shape) * size_mm / cells
    return Mesh(nodes + shift * inner[:, None], mesh.elements)


def _bump(mesh: Mesh, x_mm: float, y_mm: float) -> Image:
    """Element means of a bump whose 85 % contour is a circle of radius R, by the three-point rule of degree two."""
    points = mesh.corners_mm @ np.eye(2) * 0.5 + mesh.centroids_mm[:, None] * 0.5
    squared = ((points - np.array([x_mm, y_mm])) ** 2).sum(axis=2)
    return Image(mesh, (0.85 ** (squared / R**2)).mean(axis=1))


def _scored(image: Image, x_mm: float, y_mm: float) -> SpatialFigures:
    region = nearest_blob(contour_regions(image, 0.85), x_mm, y_mm)
    (figures,) = spatial_figures([region], RoundFootprint(x_mm, y_mm, R))
    assert figures is not None
    return figures


def test_a_contour_of_a_linear_field_is_exact():
    """u = 1 + x on the unit square: above 1.4 lies the part right of x = 0.4, wherever the elements are."""
    mesh = square_mesh(7)
    ((region,),) = field_regions(mesh, 1 + mesh.nodes_mm[:, 0], np.array([1.4]))
    assert region.area_mm2 == pytest.approx(0.6, rel=1e-14)
    assert region.weight == pytest.approx(0.6 * 1.7, rel=1e-14)
    x, y = region.centre_mm()
    # ∫₀.₄¹ x (1 + x) dx over ∫₀.₄¹ (1 + x) dx
    assert x == pytest.approx(((1 - 0.16) / 2 + (1 - 0.064) / 3) / (0.6 * 1.7), rel=1e-14)
    assert y == pytest.approx(0.5, rel=1e-14)
    start, end = region.rim_mm()
    assert np.hypot(*(end - start).T).sum() == pytest.approx(2 * 0.6 + 2, rel=1e-14)


@given(st.floats(-1, 1), st.floats(-1, 1), st.integers(3, 9))
def test_nodal_values_of_a_linear_image_are_exact_off_the_edge(along_x, along_y, cells):
    mesh = _sheet(cells)
    image = 100 + mesh.centroids_mm @ [along_x, along_y]
    nodal = nodal_values(mesh, image)
    inner = (np.abs(mesh.nodes_mm) < 19.9).all(axis=1)
    assert nodal[inner] == pytest.approx((100 + mesh.nodes_mm @ [along_x, along_y])[inner], rel=1e-12)
    edge = nodal[~inner]
    assert image.min() - 1e-9 <= edge.min()
    assert edge.max() <= image.max() + 1e-9


def test_nodal_values_keep_the_integral_to_second_order():
    def lost(cells: int) -> float:
        mesh = _sheet(cells)
        image = _bump(mesh, 1.3, -2.1).values
        nodal = nodal_values(mesh, image)
        return abs(mesh.areas_mm2 @ (nodal[mesh.elements].mean(axis=1) - image)) / (mesh.areas_mm2 @ image)

    coarse, fine = lost(20), lost(80)
    assert coarse < 0.01
    assert fine < coarse / 8


@pytest.mark.rest
@given(values, st.floats(0.05, 0.99))
def test_a_closed_rim_goes_around_exactly_the_region(image, fraction):
    for region in contour_regions(Image(SQUARE, image), fraction):
        start, end = region.rim_mm()
        around = float((start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]).sum()) / 2
        assert around == pytest.approx(region.area_mm2, rel=1e-9, abs=1e-12)
        assert (end - start).sum(axis=0) == pytest.approx([0.0, 0.0], abs=1e-9)
        low, high = region.triangles_mm.min(axis=(0, 1)), region.triangles_mm.max(axis=(0, 1))
        assert (low - 1e-9 <= region.centre_mm()).all()
        assert (region.centre_mm() <= high + 1e-9).all()


@given(values)
def test_several_masks_at_once_are_the_same_as_one_by_one(image):
    shown = Image(SQUARE, image)
    for fraction, together in zip(MASKS, find_contours_by_mask(shown, MASKS), strict=True):
        alone = contour_regions(shown, fraction)
        assert [region.weight for region in together] == pytest.approx([region.weight for region in alone])
    for fraction, blobs in zip(MASKS, find_blobs_by_mask(shown, MASKS), strict=True):
        alone_blobs = find_blobs(shown, percentage_mask(image, fraction))
        assert [blob.elements.tolist() for blob in blobs] == [blob.elements.tolist() for blob in alone_blobs]


@given(values)
def test_a_stricter_contour_encloses_less(image):
    sums = [sum(region.area_mm2 for region in found) for found in find_contours_by_mask(Image(SQUARE, image), MASKS)]
    assert all(lax >= strict - 1e-9 for lax, strict in pairwise(sums))


def test_figures_of_a_smooth_image_are_of_second_order():
    """Overlap and area with the square of the element size; place and deviation faster still."""
    places = np.random.default_rng(5).uniform(-5, 5, (12, 2))

    def errors(cells: int) -> np.ndarray:
        mesh = _sheet(cells)
        found = [_scored(_bump(mesh, x, y), x, y) for x, y in places]
        return np.mean([(f.error_mm, 100 - f.overlap_percent, f.deviation_mm2) for f in found], axis=0)

    coarse, fine = errors(20), errors(80)
    order = np.log2(coarse / fine) / 2
    assert order[0] > 1.5
    assert order[1] == pytest.approx(2.0, abs=0.4)
    assert order[2] > 3.0


def test_the_mask_itself_costs_less_than_the_reconstruction_may():
    """On the mesh of the images whole elements cost 0.2 mm and 8 % of overlap, whatever made the image."""
    layout = ElectrodeLayout(16, ElectrodeKind.PIN, 48.0, 0.65, 0.0, True)
    mesh = image_mesh(SensorType("disc", 50.0, 4.0, layout, adjacent_pattern(16), Response.AUTO), size_mm=3.0)
    counted = []
    for x, y in np.random.default_rng(2).uniform(-25, 25, (20, 2)):
        image, head = _bump(mesh, x, y), RoundFootprint(x, y, R)
        figures = _scored(image, x, y)
        assert figures.error_mm < 0.02
        assert figures.overlap_percent > 98.0
        assert figures.deviation_mm2 < 0.02
        counted += spatial_figures(find_blobs_by_mask(image, (0.85,))[0], head)
    assert np.mean([figures.error_mm for figures in counted]) > 0.15
    assert np.mean([figures.overlap_percent for figures in counted]) < 94.0


def test_two_bumps_are_two_regions_at_a_high_mask_and_one_at_a_low_one():
    mesh = _sheet(40)
    both = Image(mesh, _bump(mesh, -16.0, 0.0).values + 0.97 * _bump(mesh, 16.0, 0.0).values)
    assert len(contour_regions(both, 0.5)) == 1
    heavy, light = contour_regions(both, 0.85)
    assert heavy.weight > light.weight
    assert heavy.centre_mm()[0] < 0 < light.centre_mm()[0]


def test_a_hole_has_a_rim_of_its_own():
    mesh = disc_mesh(20.0, rings=40, spokes=96)
    distance = np.hypot(*mesh.centroids_mm.T)
    (region,) = contour_regions(Image(mesh, np.exp(-(((distance - 10) / 3) ** 2))), 0.5)
    width = 3 * np.sqrt(np.log(2))
    exact = np.pi * ((10 + width) ** 2 - (10 - width) ** 2)
    assert region.area_mm2 == pytest.approx(exact, rel=0.01)
    start, end = region.rim_mm()
    assert np.hypot(*(end - start).T).sum() == pytest.approx(2 * np.pi * 20, rel=0.01)


def test_a_region_on_the_edge_of_the_sheet_ends_there():
    mesh = _sheet(40)
    (region,) = contour_regions(_bump(mesh, 20.0, 0.0), 0.85)
    assert region.area_mm2 == pytest.approx(np.pi * R**2 / 2, rel=0.02)
    start, end = region.rim_mm()
    assert max(start[:, 0].max(), end[:, 0].max()) == 20.0
    assert np.hypot(*(end - start).T).sum() == pytest.approx(np.pi * R + 2 * R, rel=0.02)


def test_an_image_that_is_the_same_everywhere_is_one_region():
    (region,) = contour_regions(Image(SQUARE, np.full(len(SQUARE.elements), 0.3)), 0.85)
    assert region.area_mm2 == pytest.approx(36.0)
    assert region.centre_mm() == pytest.approx([3.0, 3.0])


def test_nothing_positive_is_no_region():
    empty = Image(SQUARE, np.zeros(len(SQUARE.elements)))
    assert contour_regions(empty, 0.85) == ()
    assert find_contours_by_mask(empty, MASKS) == ((), (), (), ())
    assert spatial_figures([None, None], RoundFootprint(0.0, 0.0, R)) == (None, None)


@pytest.mark.parametrize(("fraction", "said"), [(1.0, "encloses nothing"), (0.0, "mask is 0"), (1.2, "mask is 1.2")])
def test_an_impossible_mask_is_refused(fraction, said):
    with pytest.raises(NumericsError, match=said):
        contour_regions(Image(SQUARE, np.ones(len(SQUARE.elements))), fraction)


@pytest.mark.parametrize(
    ("modes", "said"), [({"clipping": "centroid"}, "centroids"), ({"perimeter": "nodes"}, "nodes")]
)
def test_what_counts_elements_needs_elements(modes, said):
    regions = contour_regions(_bump(_sheet(20), 0.0, 0.0), 0.85)
    with pytest.raises(NumericsError, match=said):
        spatial_figures(regions, RoundFootprint(0.0, 0.0, R), **modes)
