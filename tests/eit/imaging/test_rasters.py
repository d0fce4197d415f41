"""Pixel images by scikit-image, held together with exact clipping."""

import numpy as np
import pytest
from disc_meshes import disc_mesh, square_mesh, uniform_blob

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import RoundFootprint, overlap_mm2
from cbsr_qa.domain.imaging import Image, Region
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.imaging.contours import contour_regions
from cbsr_qa.eit.imaging.rasters import Raster, find_regions, outlines, split_touching
from cbsr_qa.eit.imaging.shape import area_overlap_percent, shape_deviation_mm2, spatial_figures

R = 6.5
WIDTH_MM = 100.0
HEAD = RoundFootprint(0.0, 0.0, R)


def _disc(x_mm: float, y_mm: float, radius_mm: float = R, pixels: int = 32) -> Raster:
    """A disc as the share of each pixel it covers."""
    grid = square_mesh(pixels, size_mm=WIDTH_MM)
    mesh = Mesh(grid.nodes_mm - WIDTH_MM / 2, grid.elements)
    area = overlap_mm2(RoundFootprint(x_mm, y_mm, radius_mm), mesh.corners_mm)
    pitch = WIDTH_MM / pixels
    first = -WIDTH_MM / 2 + pitch / 2
    return Raster((area[0::2] + area[1::2]).reshape(pixels, pixels) / pitch**2, pitch, (first, first))


def test_a_shifted_disc_on_32_pixels_agrees_with_exact_clipping():
    """2 mm shift in 24 directions: the contour's SD against the element form's 1.99 mm², its A_OL against 80.49 %."""
    angles = 2 * np.pi * (np.arange(24) + 0.37) / 24
    deviations, overlaps = [], []
    for angle in angles:
        (region,) = find_regions(_disc(2 * np.cos(angle), 2 * np.sin(angle)), 0.5)
        deviations.append(shape_deviation_mm2(region, HEAD))
        overlaps.append(area_overlap_percent(region, HEAD))
    exact = uniform_blob(disc_mesh(R, centre_mm=(2.0, 0.0), spokes=720))
    assert np.mean(deviations) == pytest.approx(2.04, abs=0.03)
    assert np.mean(deviations) == pytest.approx(shape_deviation_mm2(exact, HEAD), abs=0.1)
    assert np.max(np.abs(np.array(deviations) - 1.99)) < 0.25
    assert np.mean(overlaps) == pytest.approx(area_overlap_percent(exact, HEAD), abs=0.7)


def test_the_contour_converges_to_the_disc():
    def errors(pixels: int) -> np.ndarray:
        (region,) = find_regions(_disc(1.3, -0.7, pixels=pixels), 0.5)
        deviation = shape_deviation_mm2(region, RoundFootprint(1.3, -0.7, R))
        return np.abs([region.area_mm2 - np.pi * R**2, deviation])

    coarse, fine = errors(32), errors(256)
    assert (fine < coarse / 8).all()


def _bump(points: np.ndarray) -> np.ndarray:
    """A smooth image whose 85 % contour is the head moved by 2 mm: its figures are 2 mm, 80.49 %, 1.99 mm²."""
    return 0.85 ** (((points - [1.2, 1.6]) ** 2).sum(axis=-1) / R**2)


def _errors(region: Region) -> np.ndarray:
    (found,) = spatial_figures([region], HEAD)
    return np.abs([found.error_mm - 2.0, found.overlap_percent - 80.489, found.deviation_mm2 - 1.9879])


def _from_raster(pixels: int) -> np.ndarray:
    pitch = 60.0 / pixels
    axis = -30 + pitch * (np.arange(pixels) + 0.5)
    raster = Raster(_bump(np.stack(np.meshgrid(axis, axis), axis=-1)), pitch, (axis[0], axis[0]))
    return _errors(find_regions(raster, 0.85)[0])


def _from_mesh(cells: int) -> np.ndarray:
    grid = square_mesh(cells, size_mm=60.0)
    mesh = Mesh(grid.nodes_mm - 30.0, grid.elements)
    return _errors(contour_regions(Image(mesh, _bump(mesh.centroids_mm)), 0.85)[0])


@pytest.mark.parametrize("way", [_from_raster, _from_mesh])
def test_one_image_as_raster_and_on_a_mesh_scores_alike_ever_closer(way):
    """Pixels as wide as the elements; the raster's place is that of whole pixels, which is what it lags by."""
    coarse, middle, fine = way(20), way(80), way(320)
    assert (coarse < [0.35, 5.0, 0.25]).all()
    assert (middle < [0.1, 0.7, 0.03]).all()
    assert (fine < [0.02, 0.05, 0.003]).all()


def test_regions_come_heaviest_first_and_corners_do_not_join():
    values = np.zeros((4, 4))
    values[0, 0], values[1, 1] = 1.0, 3.0
    regions = find_regions(Raster(values, 2.0, (0.0, 0.0)), 0.25)
    assert [region.weight for region in regions] == [12.0, 4.0]
    assert regions[0].centre_mm().tolist() == [2.0, 2.0]


def test_an_empty_image_has_no_region_and_no_outline():
    empty = Raster(np.zeros((8, 8)), 1.0, (0.0, 0.0))
    assert find_regions(empty, 0.85) == ()
    assert split_touching(empty, 0.85, 5.0) == ()
    assert outlines(empty, 0.5) == ()


def _bumps(*centres: tuple[float, float], width_mm: float = 6.0) -> Raster:
    axis = np.linspace(-50, 50, 101)
    x, y = np.meshgrid(axis, axis)
    values = sum(np.exp(-((x - a) ** 2 + (y - b) ** 2) / 2 / width_mm**2) for a, b in centres)
    return Raster(np.asarray(values), 1.0, (-50.0, -50.0))


def test_touching_loads_are_parted_at_the_valley():
    raster = _bumps((-9.0, 5.0), (9.0, 5.0))
    assert len(find_regions(raster, 0.25)) == 1
    left, right = sorted(split_touching(raster, 0.25, 10.0), key=lambda region: region.centre_mm()[0])
    assert left.centre_mm() == pytest.approx([-9.0, 5.0], abs=1.0)
    assert right.centre_mm() == pytest.approx([9.0, 5.0], abs=1.0)
    assert not (left.pixels & right.pixels).any()
    assert ((left.pixels | right.pixels) == find_regions(raster, 0.25)[0].pixels).all()


def test_noise_does_not_part_one_load():
    bump = _bumps((3.0, 4.0), width_mm=8.0)
    noisy = bump.values + 0.02 * np.random.default_rng(1).standard_normal(bump.values.shape)
    heavy = [r for r in split_touching(Raster(noisy, 1.0, (-50.0, -50.0)), 0.5, 10.0) if r.area_mm2 > 20]
    assert len(heavy) == 1


def test_a_region_on_the_rim_has_a_closed_outline():
    values = np.zeros((6, 6))
    values[0, :] = 1.0
    raster = Raster(values, 1.0, (0.0, 0.0))
    (outline,) = outlines(raster, 0.5)
    assert outline[0].tolist() == outline[-1].tolist()
    (region,) = find_regions(raster, 0.5)
    assert region.area_mm2 == pytest.approx(6.0, abs=0.6)


def test_a_hole_is_left_out_of_the_area():
    values = np.zeros((20, 20))
    values[3:17, 3:17] = 1.0
    values[8:12, 8:12] = 0.0
    (region,) = find_regions(Raster(values, 1.0, (0.0, 0.0)), 0.5)
    assert region.area_mm2 == pytest.approx(14 * 14 - 4 * 4, abs=1.0)


def test_a_flat_image_is_one_load_and_not_none():
    (region,) = split_touching(Raster(np.full((6, 5), 0.3), 1.0, (0.0, 0.0)), 0.85, 4.0)
    assert region.pixels.all()


def test_a_small_outline_far_from_the_origin_keeps_its_area():
    one = np.zeros((5, 5))
    one[2, 2] = 1.0
    (region,) = find_regions(Raster(one, 1.0, (1e6, -1e6)), 0.85)
    assert region.area_mm2 == pytest.approx(0.045, rel=1e-8)


def test_impossible_rasters_and_separations_are_refused():
    with pytest.raises(NumericsError, match="two-dimensional"):
        Raster(np.zeros(4), 1.0, (0.0, 0.0))
    with pytest.raises(NumericsError, match="finite"):
        Raster(np.full((2, 2), np.nan), 1.0, (0.0, 0.0))
    with pytest.raises(NumericsError, match="separation"):
        split_touching(_bumps((0.0, 0.0)), 0.5, 0.0)
