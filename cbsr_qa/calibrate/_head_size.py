"""How wrong templates of a head of another size are than that which calibrated."""

from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.force_model import ForceModel

Array = NDArray[np.float64]

#: Relative error of a strength over (q − 1)², q the squared radius over the calibrated one's: everywhere, and times
#: the cube of the calibrated radius over the way to the nearest edge or electrode. Templates go linearly in q; this
#: is the next order, measured on the 100 mm disc with heads of 5 to 40 mm, up to 38 mm from the centre.
_EVERYWHERE: Final = 4e-4
_BESIDE_EDGES: Final = 0.1
#: Nodes of the lattice begin so far from edges and electrodes [of the lattice's spacing].
_FIRST_NODE: Final = 1.2
#: Relative error from which a force is flagged.
LARGEST: Final = 0.03


class SizeError:
    """Errors of heads of other sizes.

    Parameters
    ----------
    model : of the sensor.
    radius_mm : of the calibrated head.
    """

    def __init__(self, model: ForceModel, radius_mm: float) -> None:
        self._model = model
        self._radius_mm = radius_mm

    def __call__(self, size: float, places_mm: Array) -> Array:
        """Relative standard error (n,) of strengths of a head at places (n, 2); 0 of the calibrated one.

        Parameters
        ----------
        size : q, the head's squared radius over that of the calibrated one.
        """
        if size == 1:
            return np.zeros(len(places_mm))
        lattice = self._model.lattice
        at = (np.nan_to_num(places_mm) - np.array([lattice.x_mm, lattice.y_mm])) / lattice.spacing_mm
        column, row = np.clip(np.rint(at), 0, [lattice.columns - 1, lattice.rows - 1]).astype(np.int64).T
        beside = (self._radius_mm / self._clearance_mm[row, column]) ** 3
        error: Array = (size - 1) ** 2 * (_EVERYWHERE + _BESIDE_EDGES * beside)
        return error

    @cached_property
    def _clearance_mm(self) -> Array:
        """Way (rows, columns) to the nearest edge or electrode, by where the lattice has no nodes."""
        from scipy.ndimage import distance_transform_edt  # of no use to most: heads are those that calibrated

        nodes = np.pad(self._model.node >= 0, 1)
        steps = np.asarray(distance_transform_edt(nodes), dtype=np.float64)[1:-1, 1:-1]
        return (np.maximum(steps - 1, 0.0) + _FIRST_NODE) * self._model.lattice.spacing_mm
