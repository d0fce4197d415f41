"""Blobs: connected regions of the elements that a mask kept."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.image import Blob, Image, Region
from cbsr_qa.imaging.components import component_labels, groups
from cbsr_qa.imaging.masks import percentage_mask

AnyRegion = TypeVar("AnyRegion", bound=Region)


def find_blobs(image: Image, keep: NDArray[np.bool_]) -> tuple[Blob, ...]:
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
        raise NumericsError(f"a mask of {keep.shape} does not fit an image of {image.values.shape}")
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
    """Return the region whose centre of mass is nearest to a place; None where there is none.

    Of regions equally near, the first is taken: the heaviest comes first.
    """
    place = np.array([x_mm, y_mm])
    return min(blobs, key=lambda blob: float(np.hypot(*(blob.centre_mm() - place))), default=None)


def _components(image: Image, keeps: NDArray[np.bool_]) -> tuple[tuple[Blob, ...], ...]:
    """Find the blobs of several masks (m, e) in one search: a graph with a copy of the kept elements for each."""
    keeps = keeps & (image.values > 0)
    mask, element = np.nonzero(keeps)
    if not element.size:
        return ((),) * len(keeps)
    number = np.full(keeps.shape, -1, dtype=np.int64)
    number[mask, element] = np.arange(element.size)
    one, other = image.mesh.neighbours.T
    anywhere = np.logical_or.reduce(keeps)
    pairs = number[:, image.mesh.neighbours[anywhere[one] & anywhere[other]]].reshape(-1, 2)
    pairs = pairs[(pairs[:, 0] >= 0) & (pairs[:, 1] >= 0)]
    found: tuple[list[Blob], ...] = tuple([] for _ in keeps)
    for piece in groups(component_labels(element.size, pairs[:, 0], pairs[:, 1])).values():
        found[mask[piece[0]]].append(Blob(image, element[piece].astype(np.int64)))
    return tuple(tuple(sorted(blobs, key=_heaviest_first)) for blobs in found)


def _heaviest_first(blob: Blob) -> tuple[float, int]:
    return -blob.weight, int(blob.elements[0])
