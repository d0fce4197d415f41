"""Applying an imaging matrix: what single precision and large blocks of frames cost in digits and save in time."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.reconstruction import linear
from cbsr_qa.frontier.computer_figures import sensor_changes
from cbsr_qa.frontier.computer_imaging import RECIPES_METHOD, USUAL_IMAGE_SIZE_MM, made
from cbsr_qa.frontier.computer_readings import base_scene_readings
from cbsr_qa.frontier.computer_timing import fastest_s
from cbsr_qa.frontier.point import Accuracy, Clock, Point
from cbsr_qa.reconstruct.problem import imaging_problem

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]

SERIES: Final = "applying the matrix"
PRECISIONS: Final = ("float32", "float64")
BATCHES: Final = (1, 16, 256, 4096)


def precision_point(precision: str, batch: int) -> Point:
    """Measure the matrix of the shipped recipes on blocks of simulated changes.

    ``compute_s`` is the time of one frame of a block, rounding of the readings to the precision included. The error
    is the largest ‖x − x₀‖/‖x₀‖ of nine loads' images, made in blocks of this size, with x₀ computed in the longest
    floating-point numbers of the machine.

    Parameters
    ----------
    precision : ``"float32"`` or ``"float64"``, of matrix, readings and sums.
    batch : frames in a block.
    """
    matrix, changes = _matrix(), _changes()
    block = np.resize(changes, (batch, changes.shape[1]))
    apply = applied(matrix, precision)
    exact = changes.astype(np.longdouble) @ matrix.astype(np.longdouble).T
    parts = [changes[first : first + batch] for first in range(0, len(changes), batch)]
    images = [apply(np.resize(part, (batch, changes.shape[1])))[: len(part)] for part in parts]
    size = np.dtype(precision).itemsize
    return Point(
        Clock.COMPUTER,
        SERIES,
        {"precision": precision, "batch": batch},
        {"image_error": Accuracy(relative_error(np.concatenate(images), exact), None, "1")},
        fastest_s(lambda: apply(block)) / batch,
        None,
        1,
        f"{matrix.shape[1]} readings to {matrix.shape[0]} elements",
        {
            "unknowns": float(matrix.shape[0]),
            "memory_bytes": float(size * (matrix.size + batch * sum(matrix.shape))),
        },
    )


def applied(matrix: Array, precision: str) -> Callable[[Array], Floats]:
    """Return what images blocks of changes (n, m) in a precision: (n, e)."""
    kept = np.ascontiguousarray(matrix.T, dtype=precision)

    def apply(block: Array) -> Floats:
        images: Floats = block.astype(precision, copy=False) @ kept
        return images

    return apply


def relative_error(images: Floats, exact: Floats) -> float:
    """Largest ‖x − x₀‖/‖x₀‖ of images (n, e)."""
    apart, size = (np.sqrt((part**2).sum(axis=1)) for part in (images - exact, exact))
    return float((apart / size).max())


def error_bound(matrix: Array, changes: Array, precision: str) -> float:
    """Bound of :func:`relative_error`, whatever the order of summation (Higham 2002, section 3.5).

    Each product of a sum of m carries at most m roundings, and one each of matrix and reading in single precision:
    ‖x − x₀‖ ≤ γ ‖|R| |y|‖ with γ = k u/(1 − k u), k = m + 2 and u half the precision's machine epsilon.
    """
    roundings = (matrix.shape[1] + 2) * float(np.finfo(precision).eps) / 2
    most = np.linalg.norm(np.abs(changes) @ np.abs(matrix).T, axis=1) / np.linalg.norm(changes @ matrix.T, axis=1)
    return float(roundings / (1 - roundings) * most.max())


@lru_cache(maxsize=1)
def _matrix() -> Array:
    problem = imaging_problem(base_scene_readings(1).sensor_type, image_size_mm=USUAL_IMAGE_SIZE_MM)
    return linear(made(RECIPES_METHOD).prepare(problem)).matrix


@lru_cache(maxsize=1)
def _changes() -> Array:
    """Changes of the nine loads of a simulated sensor, (9, m)."""
    readings = base_scene_readings(1)
    problem = imaging_problem(readings.sensor_type, image_size_mm=USUAL_IMAGE_SIZE_MM)
    return sensor_changes(readings, 0, made(RECIPES_METHOD).prepare(problem))[1]
