"""Blobs: connected regions of the elements above a mask's threshold, from the noise floor to the components.

A run's noise floor is subtracted from its images, a percentage of the maximum masks them, and connected elements make
a blob.
"""

from collections.abc import Sequence
from typing import Final, TypeVar

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import Blob, Image, Region
from cbsr_qa.domain.numbers import Array, Indices, Mask

# Two roundings separate a value meant to be on the threshold from the threshold computed here.
_TIE: Final = 4 * np.finfo(np.float64).eps


def percentage_mask(values: Array, fraction: float) -> Mask:
    """Keep the elements (e,) that reach a fraction in (0, 1] of the image's maximum.

    Values on the threshold are kept, ties to within rounding included; zero and negative values never survive.

    NumericsError if the fraction is outside (0, 1] or a value is not finite.
    """
    return (values > 0) & (values >= threshold(values, fraction))


def threshold(values: Array, fraction: float) -> float:
    """Return the fraction of the maximum, less rounding; 0 if no value is positive. Raises as the mask."""
    if not 0 < fraction <= 1:
        raise NumericsError(f"mask is {fraction:g}; allowed: above 0, at most 1", remedy="use a fraction, e.g. 0.85")
    if not np.isfinite(values).all():
        raise NumericsError(
            "the image to be masked holds a non-finite value",
            remedy="leave non-finite readings out of the image",
        )
    return fraction * float(values.max(initial=0.0)) * (1 - _TIE)


def noise_floor(images: Array) -> float:
    """Return the largest |value| in unloaded images (k, e), relative (paper, section 3.3.2).

    NumericsError if there is no image, or a value is not finite.
    """
    if images.ndim != 2 or images.size == 0:
        raise NumericsError(
            f"the noise floor needs unloaded images of shape (k, e); shape is {images.shape}",
            remedy="record at least one frame of the rested sheet before the first press",
        )
    if not np.isfinite(images).all():
        raise NumericsError("an unloaded image holds a non-finite value")
    return float(np.abs(images).max())


def subtract_noise_floor(values: Array, floor: float) -> Array:
    """Subtract the noise floor from values (…, e), for masks and blobs only; zero below it.

    NumericsError if the floor is negative or not finite.
    """
    if not 0 <= floor < float("inf"):
        raise NumericsError(f"the noise floor is {floor}; it must be a finite number of at least 0")
    return np.maximum(values - floor, 0.0)


def component_labels(count: int, edges: Indices) -> Indices:
    """Number the component of each vertex of a graph with edges (k, 2), by lowest vertex: (count,)."""
    graph = coo_array((np.ones(len(edges), dtype=np.bool_), edges.T), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def groups(labels: Indices) -> dict[int, Indices]:
    """Rising indices of each label, by label."""
    order = np.argsort(labels, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    return {int(labels[members[0]]): members for members in parts if members.size}


AnyRegion = TypeVar("AnyRegion", bound=Region)


def find_blobs(image: Image, keep: Mask) -> tuple[Blob, ...]:
    """Find the connected components of kept elements (e,) over shared edges; a kept value must be positive.

    Returns
    -------
    tuple of Blob, the heaviest first (of equals, the one with the lowest element index); empty for "no blob".

    Raises
    ------
    NumericsError
        If the mask does not fit the image.
    """
    if keep.shape != image.values.shape:
        raise NumericsError(f"mask {keep.shape} does not match an image of shape {image.values.shape}")
    return _components(image, keep[None])[0]


def find_blobs_by_mask(image: Image, fractions: Sequence[float]) -> tuple[tuple[Blob, ...], ...]:
    """Find the blobs of several percentage masks of one image: one tuple per mask, as in :func:`find_blobs`.

    NumericsError if a fraction is outside (0, 1].
    """
    if not len(fractions):
        return ()
    return _components(image, np.array([percentage_mask(image.values, fraction) for fraction in fractions]))


def nearest_blob(blobs: Sequence[AnyRegion], x_mm: float, y_mm: float) -> AnyRegion | None:
    """Return the region with its centre of mass nearest to a place (the first of equals); None without regions."""
    place = np.array([x_mm, y_mm])
    return min(blobs, key=lambda blob: float(np.hypot(*(blob.centre_mm() - place))), default=None)


def _components(image: Image, keeps: Mask) -> tuple[tuple[Blob, ...], ...]:
    """Find the blobs of several masks (m, e) in one search: a graph with a copy of the kept elements for each."""
    keeps = keeps & (image.values > 0)
    mask, element = np.nonzero(keeps)
    if not element.size:
        return ((),) * len(keeps)
    number = np.full(keeps.shape, -1, dtype=np.int64)
    number[mask, element] = np.arange(element.size)
    first, second = image.mesh.neighbours.T
    anywhere = np.logical_or.reduce(keeps)
    pairs = number[:, image.mesh.neighbours[anywhere[first] & anywhere[second]]].reshape(-1, 2)
    pairs = pairs[(pairs[:, 0] >= 0) & (pairs[:, 1] >= 0)]
    blobs_of: tuple[list[Blob], ...] = tuple([] for _ in keeps)
    for piece in groups(component_labels(element.size, pairs)).values():
        blobs_of[mask[piece[0]]].append(Blob(image, element[piece].astype(np.int64)))
    return tuple(tuple(sorted(blobs, key=lambda b: (-b.weight, int(b.elements[0])))) for blobs in blobs_of)
