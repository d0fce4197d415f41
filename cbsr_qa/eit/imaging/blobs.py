"""Blobs: connected regions of the elements above a mask's threshold, from the noise floor to the components.

A run's noise floor is subtracted from its images, a percentage of the maximum masks them, and connected elements make
a blob. Components of small graphs are found several times faster than through a sparse matrix.
"""

from collections.abc import Sequence
from typing import Final, TypeVar

import numpy as np

from cbsr_qa.domain import Array, Indices, Mask, NumericsError
from cbsr_qa.domain.results import Blob, Image, Region

# Two roundings stand between a value that was meant to lie on the threshold and the threshold computed here.
_TIE: Final = 4 * np.finfo(np.float64).eps


def percentage_mask(values: Array, fraction: float) -> Mask:
    """Keep the elements that reach a fraction of the image's maximum.

    Values on the threshold are kept, ties to within rounding included; zero and negative values never survive,
    so that an image without a positive element keeps nothing.

    Parameters
    ----------
    values : (e,) float64, response-signed, noise floor subtracted.
    fraction : p in (0, 1].

    Returns
    -------
    (e,) bool.

    Raises
    ------
    NumericsError
        If the fraction is outside (0, 1] or a value is not finite.
    """
    return (values > 0) & (values >= threshold(values, fraction))


def threshold(values: Array, fraction: float) -> float:
    """Return the threshold of a mask: the fraction of the maximum, less rounding; 0 if no value is positive.

    Raises
    ------
    NumericsError
        If the fraction is outside (0, 1] or a value is not finite.
    """
    if not 0 < fraction <= 1:
        raise NumericsError(f"mask is {fraction:g}; allowed: above 0, at most 1", remedy="use a fraction, e.g. 0.85")
    if not np.isfinite(values).all():
        raise NumericsError(
            "the image to be masked holds a non-finite value",
            remedy="leave non-finite readings out of the image",
        )
    return fraction * float(values.max(initial=0.0)) * (1 - _TIE)


def noise_floor(images: Array) -> float:
    """Return the largest value that noise alone put anywhere into the unloaded images.

    Per element the largest |value| over the images, then the maximum over the elements (paper, section 3.3.2).

    Parameters
    ----------
    images : (k, e) float64, k ≥ 1 images of the rested, unloaded sheet, relative.

    Returns
    -------
    float ≥ 0, relative.

    Raises
    ------
    NumericsError
        If there is no image, or a value is not finite.
    """
    if images.ndim != 2 or images.size == 0:
        raise NumericsError(
            f"the noise floor needs unloaded images of shape (k, e); shape is {images.shape}",
            remedy="record at least one frame of the rested sheet before the first press",
        )
    if not np.isfinite(images).all():
        raise NumericsError("an unloaded image holds a non-finite value")
    return float(np.abs(images).max())


def floored(values: Array, floor: float) -> Array:
    """Subtract the noise floor, for masks and blobs only: amplitudes are taken from un-subtracted images.

    Parameters
    ----------
    values : (…, e) float64, response-signed.
    floor : ≥ 0, same unit.

    Returns
    -------
    float64 of the same shape, ≥ 0: zero below the floor (and for every negative value), value − floor above it.

    Raises
    ------
    NumericsError
        If the floor is negative or not finite.
    """
    if not 0 <= floor < float("inf"):
        raise NumericsError(f"the noise floor is {floor}; it must be a finite number of at least 0")
    return np.maximum(values - floor, 0.0)


def component_labels(count: int, first: Indices, second: Indices) -> Indices:
    """Label the vertices of a graph by the lowest vertex each is connected to (Shiloach & Vishkin 1982).

    Every label is a vertex of its component. Joining components along all edges at once and then following labels
    to their end takes a number of rounds that grows with the logarithm of the components' size.

    Parameters
    ----------
    count : vertices.
    first, second : (k,) ends of the edges.

    Returns
    -------
    (count,) int64.
    """
    label = np.arange(count)
    while True:
        near, far = label[first], label[second]
        apart = near != far
        if not apart.any():
            return label
        first, second, near, far = first[apart], second[apart], near[apart], far[apart]
        lower = np.minimum(near, far)
        np.minimum.at(label, near, lower)
        np.minimum.at(label, far, lower)
        label = _followed(label)


def groups(labels: Indices) -> dict[int, Indices]:
    """Where each label is found: indices in rising order, by label."""
    order = np.argsort(labels, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    return {int(labels[part[0]]): part for part in parts if part.size}


def _followed(label: Indices) -> Indices:
    while True:
        further = label[label]
        if (further == label).all():
            return label
        label = further


AnyRegion = TypeVar("AnyRegion", bound=Region)


def find_blobs(image: Image, keep: Mask) -> tuple[Blob, ...]:
    """Find the connected components of kept elements over shared edges.

    Elements that meet in a corner only are not connected. A kept element without a positive value is dropped:
    it would have no weight. The mesh remembers its neighbours, so a further image costs the components alone.

    Parameters
    ----------
    image : response-signed, noise floor subtracted.
    keep : (e,) bool.

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


def masked_blobs(image: Image, fractions: Sequence[float]) -> tuple[tuple[Blob, ...], ...]:
    """Find the blobs that several percentage masks leave of one image, at little more than the cost of the laxest.

    Returns
    -------
    One tuple per mask, in the order given, each as :func:`find_blobs` returns it.

    Raises
    ------
    NumericsError
        If a fraction is outside (0, 1].
    """
    if not len(fractions):
        return ()
    return _components(image, np.array([percentage_mask(image.values, fraction) for fraction in fractions]))


def nearest_blob(blobs: Sequence[AnyRegion], x_mm: float, y_mm: float) -> AnyRegion | None:
    """Return the region whose centre of mass is nearest to a place, or None if there is no region.

    Of regions equally near, the first is taken: the heaviest comes first.
    """
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
    for piece in groups(component_labels(element.size, pairs[:, 0], pairs[:, 1])).values():
        blobs_of[mask[piece[0]]].append(Blob(image, element[piece].astype(np.int64)))
    return tuple(tuple(sorted(blobs, key=_heaviest_first)) for blobs in blobs_of)


def _heaviest_first(blob: Blob) -> tuple[float, int]:
    return -blob.weight, int(blob.elements[0])
