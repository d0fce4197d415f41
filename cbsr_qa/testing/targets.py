"""Targets on a small problem, and the blobs images make of them: what the conformance checks look at."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.reconstruction import ImagingProblem, PreparedReconstruction
from cbsr_qa.reconstruct.problem import imaging_problem, target_signal

Array = NDArray[np.float64]

#: Where targets are, in units of the sheet's radius.
PLACES = ((0.1, 0.05), (0.5, 0.2), (-0.4, 0.3), (-0.1, -0.55))
CONTRAST = 0.2

_TARGET_RADIUS = 0.13  # of the sheet's radius: the 13 mm indenter on the 100 mm disc
_BLOB = 0.5  # an image's blob is what exceeds this share of its maximum
_NOISE = 1e-3  # of a reading: 60 dB


def example_problem(*, used: NDArray[np.bool_] | None = None) -> ImagingProblem:
    """Return the shipped 100 mm disc on a coarse image mesh, with reference readings of an ideal sensor."""
    problem = imaging_problem(load_sensor_type("disc-100mm").value, used=used, image_size_mm=6.0)
    return replace(problem, measured=problem.reference)


def noise_deviation(problem: ImagingProblem) -> Array:
    """Standard deviation of readings with 60 dB, (m,)."""
    deviation: Array = _NOISE * np.abs(problem.reference)
    return deviation


def noise(problem: ImagingProblem, random: np.random.Generator, frames: int) -> Array:
    """Frames of noise at 60 dB, (frames, m)."""
    deviation = noise_deviation(problem)
    drawn: Array = deviation * random.standard_normal((frames, len(deviation)))
    return drawn


def signal(problem: ImagingProblem, at: tuple[float, float], contrast: float) -> Array:
    """Readings' change for an indenter-sized target, (m,).

    Parameters
    ----------
    at : in units of the sheet's radius. contrast : Δγ/γ₀.
    """
    radius = problem.sensor_type.radius_mm
    return target_signal(
        problem, x_mm=at[0] * radius, y_mm=at[1] * radius, radius_mm=_TARGET_RADIUS * radius, contrast=contrast
    )


def found_at(prepared: PreparedReconstruction, at: tuple[float, float], contrast: float) -> Array:
    """Centre [mm] of the blob a target makes, (2,).

    Raises
    ------
    AssertionError
        If the image is none, or the blob has the other sign.
    """
    image = prepared.images(signal(prepared.problem, at, contrast)[None])[0]
    check_image(prepared, image)
    if not np.sign(contrast) * (image.max() + image.min()) > 0:
        raise AssertionError(
            f"{prepared.method} answers a target of {contrast:+.0%} at {at} of the radius with the other sign"
        )
    return blob_centre(prepared, np.sign(contrast) * image)


def check_image(prepared: PreparedReconstruction, image: Array) -> None:
    """Assert that an image has a finite value on each element of its mesh."""
    elements = len(prepared.problem.mesh.elements)
    if image.shape != (elements,):
        raise AssertionError(f"{prepared.method} makes images of shape {image.shape} on {elements} elements")
    if not np.isfinite(image).all():
        raise AssertionError(f"{prepared.method} makes an image that is not finite")


def blob_centre(prepared: PreparedReconstruction, image: Array) -> Array:
    """Centre of mass [mm] of what an image has above half its maximum, (2,).

    Half the maximum is subtracted, so that an element at the threshold does not make the centre jump.
    """
    mesh = prepared.problem.mesh
    weights = np.maximum(image - _BLOB * image.max(), 0) * mesh.areas_mm2
    centre: Array = weights @ mesh.centroids_mm / weights.sum()
    return centre
