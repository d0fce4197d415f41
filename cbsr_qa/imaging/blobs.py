"""Blobs: connected regions of the elements that a mask kept."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.image import Blob, Image


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
    kept = np.flatnonzero(keep & (image.values > 0))
    if kept.size == 0:
        return ()
    count, label = connected_components(_links(image, kept), directed=False)
    order = np.argsort(label, kind="stable")
    pieces = np.split(kept[order], np.flatnonzero(np.diff(label[order])) + 1)
    assert len(pieces) == count
    blobs = [Blob(image, np.sort(piece).astype(np.int64)) for piece in pieces]
    return tuple(sorted(blobs, key=lambda blob: (-blob.weight, int(blob.elements[0]))))


def nearest_blob(blobs: Sequence[Blob], x_mm: float, y_mm: float) -> Blob | None:
    """Return the blob whose centre of mass is nearest to a place; None where there is no blob.

    Of blobs equally near, the first is taken: :func:`find_blobs` puts the heaviest first.
    """
    place = np.array([x_mm, y_mm])
    return min(blobs, key=lambda blob: float(np.hypot(*(blob.centre_mm() - place))), default=None)


def _links(image: Image, kept: NDArray[np.intp]) -> coo_array:
    number = np.full(image.values.size, -1, dtype=np.int64)
    number[kept] = np.arange(kept.size)
    pairs = number[image.mesh.neighbours]
    pairs = pairs[(pairs >= 0).all(axis=1)]
    return coo_array((np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(kept.size, kept.size))
