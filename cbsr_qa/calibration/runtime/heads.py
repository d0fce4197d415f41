"""Forces of heads that were fitted together, those that cannot be told apart as one.

How wrong templates of a head of another size are than that which calibrated.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.runtime.force import Flag, ForceInverse, Forces, Newtons, SeveralForces, range_flags
from cbsr_qa.calibration.runtime.multi_load import Heads
from cbsr_qa.calibration.runtime.template_matching import Matches
from cbsr_qa.domain.results import ForceModel, Validity

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
        at = (np.nan_to_num(places_mm) - np.array(lattice.origin_mm)) / lattice.spacing_mm
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


#: What heads that were not found add to a sum, over the root of the share of the signal they explain: heads where the
#: sheet shows little press harder than they look.
_MISSING: Final = 2.0


def forces_together(
    heads: Heads,
    unexplained: float,
    inverse: ForceInverse,
    validity: Validity,
    *,
    nearest_mm: float,
    sign: float,
    other_head: NDArray[np.bool_],
) -> SeveralForces:
    """Forces of the heads in one frame.

    What map, scatter and line are off by is taken for shared by all heads of a sum.

    Parameters
    ----------
    heads : strengths those of the inverse's head.
    unexplained : share of the frame's signal, as energy, that further heads explain; 0 where there are none.
    nearest_mm : heads nearer than this are not told apart.
    sign : of the response.
    other_head : (k,) whether a head's templates are off by more than is allowed.
    """
    newtons = inverse.newtons(_matches(heads))
    groups = heads.groups(nearest_mm)
    parts = [_sum(heads, newtons, group) for group in groups]
    force, stderr, place, place_stderr = (np.array(values) for values in zip(*parts, strict=True))
    missing = _MISSING * np.sqrt(unexplained)
    stderr = np.hypot(stderr, missing * np.abs(force))
    flags = range_flags(force, stderr, place, validity)
    together = np.array([len(group) > 1 for group in groups]) | (unexplained > 0)
    flags[together] |= Flag.MORE_THAN_ONE
    flags[np.array([heads.strength[group].sum() * sign < 0 for group in groups])] |= Flag.WRONG_SIGN
    flags[np.array([other_head[group].any() for group in groups])] |= Flag.OTHER_HEAD
    detectability = np.array([heads.detectability[group].max() for group in groups])
    loads = Forces(force, stderr, place, place_stderr, detectability, flags)
    total, total_stderr, _, _ = _sum(heads, newtons, range(len(heads)))
    whole = Flag.MORE_THAN_ONE if together.any() else Flag(0)
    return SeveralForces(loads, total, float(np.hypot(total_stderr, missing * abs(total))), whole)


def nothing_together(total_N: float, stderr_N: float, flags: Flag) -> SeveralForces:
    """A frame without any head."""
    none, places = np.zeros(0), np.zeros((0, 2))
    loads = Forces(none, none, places, none, none, np.zeros(0, dtype=np.int64))
    return SeveralForces(loads, total_N, stderr_N, flags)


def _matches(heads: Heads) -> Matches:
    blocks = np.array([heads.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(len(heads))])
    return Matches(heads.place_mm, heads.strength, blocks, heads.detectability**2, heads.detectability**2)


def _sum(heads: Heads, newtons: Newtons, group: Sequence[int]) -> tuple[float, float, Array, float]:
    """Sum of some heads' forces with its error, their middle, weighted by force, and how sure that is."""
    which = np.array(group)
    entries = (3 * which[:, None] + np.arange(3)).ravel()
    covariance = heads.covariance[np.ix_(entries, entries)]
    slope = newtons.slope[which].ravel()
    shared = float(np.sqrt(newtons.variance[which]).sum())
    stderr = float(np.hypot(np.sqrt(max(float(slope @ covariance @ slope), 0.0)), shared))
    force = newtons.force[which]
    weight = np.abs(force) / np.abs(force).sum()
    middle: Array = weight @ heads.place_mm[which]
    spread = weight @ ((heads.place_mm[which] - middle) ** 2).sum(axis=1)
    places = [covariance[3 * k + axis, 3 * k + axis] for k in range(len(which)) for axis in (1, 2)]
    variance = weight @ np.array(places).reshape(-1, 2).sum(axis=1)
    return float(force.sum()), stderr, middle, float(np.sqrt((variance + spread) / 2))
