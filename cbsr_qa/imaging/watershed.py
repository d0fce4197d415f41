"""Touching loads parted on a mesh: a blob with several peaks is cut along the valleys between them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.image import Blob


def split_blobs(blobs: Sequence[Blob], prominence: float) -> tuple[Blob, ...]:
    """Part blobs that hold several peaks (watershed by flooding, Vincent & Soille 1991, on the mesh's elements).

    A peak counts where one has to go down by more than the prominence before one can climb to a higher one: so noise
    on a plateau parts nothing.

    Parameters
    ----------
    prominence : a share of the largest value of all blobs, in (0, 1).

    Returns
    -------
    Heaviest first; blobs with one peak are as they were.

    Raises
    ------
    NumericsError
        If the prominence is outside (0, 1).
    """
    if not 0 < prominence < 1:
        raise NumericsError(
            f"a prominence of {prominence:g} is outside (0, 1)", remedy="give it as a share of the peak, e.g. 0.05"
        )
    if not blobs:
        return ()
    depth = prominence * max(float(blob.image.values[blob.elements].max()) for blob in blobs)
    parts = [part for blob in blobs for part in _parted(blob, depth)]
    return tuple(sorted(parts, key=lambda part: (-part.weight, int(part.elements[0]))))


def _parted(blob: Blob, depth: float) -> list[Blob]:
    basin = _flooded(blob.image.values[blob.elements], _neighbours(blob), depth)
    numbers = np.unique(basin)
    if len(numbers) == 1:
        return [blob]
    return [Blob(blob.image, blob.elements[basin == number]) for number in numbers]


def _neighbours(blob: Blob) -> list[list[int]]:
    """Neighbours of each element within the blob, by place in the blob."""
    number = np.full(len(blob.image.values), -1, dtype=np.int64)
    number[blob.elements] = np.arange(len(blob.elements))
    pairs = number[blob.image.mesh.neighbours]
    around: list[list[int]] = [[] for _ in blob.elements]
    for one, other in pairs[(pairs[:, 0] >= 0) & (pairs[:, 1] >= 0)].tolist():
        around[one].append(other)
        around[other].append(one)
    return around


def _flooded(values: NDArray[np.float64], around: list[list[int]], depth: float) -> NDArray[np.int64]:
    """Number of the basin, by its peak, of every element: the level falls from the highest peak to the rim.

    An element between basins goes to that of its highest neighbour. Where two meet, the lower one is joined to the
    higher one unless its peak stands above the valley by more than the depth.
    """
    into = list(range(len(values)))  # a basin that was joined to another points to it
    basin = np.full(len(values), -1, dtype=np.int64)

    def found(peak: int) -> int:
        while into[peak] != peak:
            peak = into[peak]
        return peak

    for element in np.argsort(-values, kind="stable").tolist():
        known = sorted((other for other in around[element] if basin[other] >= 0), key=lambda k: -values[k])
        if not known:
            basin[element] = element
            continue
        basin[element] = basin[known[0]]
        peaks = sorted({found(int(basin[other])) for other in known}, key=lambda k: (-values[k], k))
        for peak in peaks[1:]:
            if values[peak] - values[element] <= depth:
                into[peak] = peaks[0]
    return np.array([found(int(number)) for number in basin])
