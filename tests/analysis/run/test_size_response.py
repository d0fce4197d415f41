"""Area of regions against area of targets, for images whose blur is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cbsr_qa.analysis.run.sizes import FLAT, size_response
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import LinearReconstruction, ParameterChoice
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa_plugins.sections.image_quality import describe_sizes

_LOG = np.log(1 / 0.85)


@pytest.fixture(scope="module")
def blurring():
    """A stand-in for a method whose image of any conductance is its convolution with a Gaussian of known width."""
    problem = imaging_problem(load_sensor_type("disc-100mm").value, image_size_mm=2.0)
    mesh = problem.mesh
    count = len(mesh.elements)
    problem = replace(
        problem, jacobian=np.eye(count), reference=np.ones(count), used=np.ones((1, count), dtype=bool), nominal=None
    )

    def method(width_mm: float) -> LinearReconstruction:
        kernel = cdist(mesh.centroids_mm, mesh.centroids_mm, "sqeuclidean")
        kernel *= -0.5 / width_mm**2
        np.exp(kernel, out=kernel)
        kernel *= mesh.areas_mm2
        return LinearReconstruction("blur", problem, kernel, ParameterChoice(0.0, "none", 1.0))

    return method


@pytest.mark.rest
def test_an_image_much_wider_than_the_targets_is_flat_by_just_what_blurring_says(blurring):
    """The image's second moment is the blur's and r²/4 of the disc; its 85 % contour encloses 2π ln(1/0.85) of it."""
    found = size_response(blurring(11.0), head_diameter_mm=13.0)
    assert [one.place for one in found] == ["centre", "30 mm out"]
    centre = found[0]
    assert centre.diameters_mm == pytest.approx((8.0, 13.0, 20.0))
    moments = [11.0**2 + (d / 2) ** 2 / 4 for d in centre.diameters_mm]
    np.testing.assert_allclose(centre.areas_mm2, 2 * np.pi * _LOG * np.array(moments), rtol=0.02)
    assert centre.slope == pytest.approx(0.09, abs=0.02)
    assert all(one.flat for one in found)
    assert "flat" in describe_sizes(found)
    assert "area of a load grows 6.2 times" in describe_sizes(found)


def test_an_image_much_finer_than_the_targets_follows_their_size(blurring):
    found = size_response(blurring(1.2), head_diameter_mm=13.0)
    for one in found:
        assert one.slope > 0.8
        assert not one.flat
        assert np.all(np.array(one.areas_mm2) < np.pi / 4 * np.array(one.diameters_mm) ** 2)
    assert "flat" not in describe_sizes(found)


@pytest.mark.rest
def test_the_sharper_the_image_the_steeper(blurring):
    slopes = [size_response(blurring(width), head_diameter_mm=13.0)[0].slope for width in (2.0, 4.0, 8.0, 16.0)]
    assert np.all(np.diff(slopes) < 0)
    assert slopes[-1] < FLAT < slopes[0]


@pytest.mark.rest
def test_no_region_is_no_slope_and_flat(blurring):
    method = blurring(5.0)
    dark = replace(method, matrix=-np.abs(method.matrix))
    for one in size_response(dark, head_diameter_mm=13.0):
        assert one.areas_mm2 == (None, None, None)
        assert one.slope is None
        assert one.flat


def test_a_head_of_no_size_or_too_large_is_refused_and_one_that_fits_the_centre_is_measured_there(blurring):
    method = blurring(5.0)
    with pytest.raises(NumericsError, match="positive diameter"):
        size_response(method, head_diameter_mm=0.0)
    with pytest.raises(NumericsError, match="fits neither"):
        size_response(method, head_diameter_mm=80.0)
    assert [one.place for one in size_response(method, head_diameter_mm=30.0)] == ["centre"]
