"""What every method that is not one matrix asks of the readings it is given."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.reconstruction import ImagingProblem

Array = NDArray[np.float64]


def checked_changes(changes: Array, problem: ImagingProblem) -> Array:
    """Changes (n, m) as float64.

    Raises
    ------
    RefusedError
        As ``LinearReconstruction.images``: if the number of readings is not the prepared one, or one is not finite.
    """
    count = len(problem.reference)
    if changes.ndim != 2 or changes.shape[1] != count:
        raise RefusedError(f"readings of shape {changes.shape} do not fit {count} used channels")
    if not np.isfinite(changes).all():
        raise RefusedError("a reading is not a finite number; mask its channel instead of imaging it")
    return np.asarray(changes, dtype=np.float64)
