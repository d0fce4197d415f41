"""Linear images on square pixels."""

from dataclasses import replace

import numpy as np
import pytest

from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.geometry.outlines import Polygon
from cbsr_qa.domain.imaging import LinearReconstruction, ParameterChoice
from cbsr_qa.eit.inverse.pixels import PixelImaging, pixel_imaging
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa_plugins.reconstruction.direct import LinearBackProjection
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonLaplace


@pytest.fixture(scope="module")
def linear(pin_sensor) -> LinearReconstruction:
    return GaussNewtonLaplace().prepare(imaging_problem(pin_sensor(), image_size_mm=5.0))


@pytest.fixture(scope="module")
def raster(linear) -> PixelImaging:
    return pixel_imaging(linear, 12)


def readings_of(linear: LinearReconstruction, frames: int = 5) -> np.ndarray:
    drawn = np.random.default_rng(3).standard_normal((frames, linear.matrix.shape[1]))
    return drawn * np.abs(linear.problem.reference)


def sampled(linear: LinearReconstruction, raster: PixelImaging, values: np.ndarray, per_side: int = 14) -> np.ndarray:
    """Mean over points of each pixel that lie in the mesh: slowly, and element by element."""
    steps = (np.arange(per_side) + 0.5) / per_side - 0.5
    x = (raster.first_mm[0] + raster.pitch_mm * (np.arange(raster.pixels)[:, None] + steps)).ravel()
    grid = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    found = np.full(len(grid), np.nan)
    for corners, value in zip(linear.problem.mesh.corners_mm, values, strict=True):
        sides = np.roll(corners, -1, axis=0) - corners
        off = grid[:, None] - corners
        inside = (sides[:, 0] * off[..., 1] - sides[:, 1] * off[..., 0] >= 0).all(axis=1)
        found[inside] = value
    blocks = found.reshape(raster.pixels, per_side, raster.pixels, per_side)
    counted = np.isfinite(blocks).sum(axis=(1, 3))
    return np.nansum(blocks, axis=(1, 3)) / np.maximum(counted, 1)


def test_a_pixel_is_the_mean_over_what_it_covers(linear, raster):
    readings = readings_of(linear, 1)
    expected = sampled(linear, raster, linear.images(readings)[0])
    difference = (raster.image(readings[0]) - expected)[raster.inside]
    assert np.sqrt((difference**2).mean()) < 0.01 * np.abs(expected).max()
    assert not raster.image(readings[0])[~raster.inside].any()


def test_the_integral_over_the_sheet_is_kept(linear):
    """However coarse the raster: with the area each pixel covers of the sheet."""
    readings, mesh = readings_of(linear, 1), linear.problem.mesh
    whole = linear.images(readings)[0] @ mesh.areas_mm2 / mesh.areas_mm2.sum()
    assert pixel_imaging(linear, 1).image(readings[0])[0, 0] == pytest.approx(whole, rel=1e-5)


def test_one_frame_and_many_are_the_same_image(linear, raster):
    readings = readings_of(linear)
    together = raster.images(readings)
    assert together.shape == (5, 12, 12)
    for frame, image in zip(readings, together, strict=True):
        assert np.abs(raster.image(frame) - image).max() < 1e-5 * np.abs(image).max()


@pytest.mark.parametrize("weighted", [False, True])
def test_single_precision_rounds_far_below_noise(pin_sensor, weighted):
    """Against the same raster in double precision: as much as 24 bits of the readings would."""
    sensor = pin_sensor()
    variance = np.random.default_rng(5).uniform(0.3, 3.0, (16, 16)) if weighted else None
    used = sensor.pattern.usable()
    used[4] &= not weighted
    problem = imaging_problem(sensor, used=used, noise_variance=variance, image_size_mm=6.0)
    linear, areas = GaussNewtonLaplace().prepare(problem), problem.mesh.areas_mm2
    raster = pixel_imaging(linear, 1)  # one pixel: its row is known in double precision
    assert (raster.ratio is None) is not weighted
    assert len(raster.one) == 104
    row = areas @ linear.matrix / areas.sum()
    for readings in readings_of(linear, 50):
        most = np.abs(row) @ np.abs(readings)
        assert abs(raster.image(readings)[0, 0] - row @ readings) < 2e-7 * most


def test_methods_that_fold_nothing_are_put_on_pixels_all_the_same(linear):
    problem = linear.problem
    matrix = np.random.default_rng(1).standard_normal(linear.matrix.shape)
    other = LinearReconstruction("any", problem, matrix, ParameterChoice(0.0, "", 1.0))
    readings = readings_of(other, 2)
    for method in (other, LinearBackProjection().prepare(problem)):
        raster = pixel_imaging(method, 1)
        areas = problem.mesh.areas_mm2
        means = method.images(readings) @ areas / areas.sum()
        assert np.allclose(raster.images(readings)[:, 0, 0], means, rtol=1e-4)
    assert len(pixel_imaging(other, 4).one) == 208


def test_a_raster_spans_the_sheet_whatever_its_outline(linear, pin_sensor):
    raster = pixel_imaging(linear, 10)
    assert (raster.pitch_mm, raster.first_mm) == (10.0, (-45.0, -45.0))
    outline = Polygon(((0.0, 0.0), (60.0, 0.0), (60.0, 30.0), (0.0, 30.0)))
    sensor = replace(pin_sensor(), radius_mm=outline.radius_mm, polygon=outline)
    problem = replace(linear.problem, sensor_type=sensor)
    placed = pixel_imaging(replace(linear, problem=problem), 6)
    assert (placed.pitch_mm, placed.first_mm) == (10.0, (5.0, -10.0))


def test_what_is_no_frame_is_refused(linear, raster):
    good = readings_of(linear)
    for wrong in (good[:, :-1], good[0], np.where(good > 0, np.nan, good), np.full_like(good, np.inf)):
        with pytest.raises(RefusedError, match=r"do not match|not a finite number"):
            raster.images(wrong)
    for wrong in (good, good[0, :-1], np.full(208, np.nan)):
        with pytest.raises(RefusedError, match=r"do not match|not a finite number"):
            raster.image(wrong)
    with pytest.raises(NumericsError, match="0 pixels"):
        pixel_imaging(linear, 0)
