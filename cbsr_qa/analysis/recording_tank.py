"""Tanks that are no sheets: how deep one is, told from its reference frame, and the patterns of balls in it.

In a tank readings fall off faster with distance than on a sheet, and a large ball is not a small one: the parts of it
that are near an electrode are seen by it alone. In a tank as deep as it is wide a sheet's patterns put balls of 0.15
radii up to 0.04 radii too far out; those of balls of the right size, in the tank, are right within 0.01 up to 0.6.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from cbsr_qa.analysis.recording_imaging import Sheet
from cbsr_qa.analysis.recording_objects import Object
from cbsr_qa.domain.electrodes import ElectrodeLayout
from cbsr_qa.domain.patterns import DrivePattern
from cbsr_qa.domain.reconstruction import ImagingProblem
from cbsr_qa.forward.deep_tank import DeepTank

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_DEPTHS: Final = (0.3, 5.0)  # in radii: shallower is a sheet, deeper looks alike
_THIN: Final = 0.05  # depth that stands for a sheet
_ELECTRODE: Final = 0.1  # width and height of a nominal electrode, of the radius
_EXPLAINED: Final = 0.05  # deviation of log readings over distances that a tank may leave,
_OF_SHEET: Final = 0.25  # and of what a sheet leaves
_FEWEST: Final = 5  # distances between drive and measurement
_SIZES: Final = (0.02, 0.3)  # radii of balls, of the tank's


@dataclass(frozen=True, slots=True, eq=False)
class Tank:
    """A round tank with electrodes at mid-height.

    Parameters
    ----------
    depth : in units of the radius.
    field : of it.
    """

    depth: float
    field: DeepTank

    def sheet(self, sheet: Sheet, *, ball: float, conducts: bool) -> Sheet:
        """Put the patterns of balls of a radius (in units of the tank's) in the place of a sheet's.

        Signs stay as they are on a sheet: positive for what conducts more.
        """
        used = sheet.problem.used
        reference = self.field.readings()[used]
        changes = self.field.changes(sheet.places, ball, conducts=conducts)[:, used].T * (1 if conducts else -1)
        patterns = changes / reference[:, None] * sheet.problem.reference[:, None]
        return replace(sheet, patterns=patterns)

    def ball_of(self, found: tuple[Object, ...], sheet: Sheet, change: Array) -> tuple[float, bool]:
        """Radius of the balls, and whether they conduct, that the found places and the size of a change call for.

        Nothing changes readings more than a perfect insulator or conductor, so that no smaller ball explains them.

        Parameters
        ----------
        change : (m,) of the sheet's readings.
        """
        basis = np.column_stack([*(sheet.patterns[:, one.place.index] for one in found), sheet.problem.reference])
        volume = np.linalg.lstsq(basis, change, rcond=None)[0][:-1]
        radius = float(np.mean(np.cbrt(3 * np.abs(volume) / (4 * np.pi))))
        return min(max(radius, _SIZES[0]), _SIZES[1]), bool(volume.sum() > 0)


def fitted_tank(reference: Array, problem: ImagingProblem) -> Tank | None:
    """Fit the depth of a tank to its reference frame: one number, from how readings fall off with distance.

    Parameters
    ----------
    reference : (m,), the used readings, of either sign.

    Returns
    -------
    Tank, or None where a sheet explains the readings as well, or a tank does not (channels of unequal gain).
    """
    electrodes, pattern, used = problem.sensor_type.electrodes, problem.sensor_type.pattern, problem.used
    if not isinstance(electrodes, ElectrodeLayout) or pattern.shape[0] != pattern.shape[1]:
        return None
    groups = _distances(pattern, used)
    if len(groups) < _FEWEST:
        return None
    angles = electrodes.angles_rad()

    def left(depth: float) -> float:
        field = DeepTank(depth, angles, pattern, electrode=_ELECTRODE)
        ratio = np.log(np.abs(reference / field.readings()[used]))
        return float(np.std([np.median(ratio[group]) for group in groups]))

    found = minimize_scalar(left, bounds=_DEPTHS, method="bounded", options={"xatol": 1e-3})
    depth = float(found.x)
    if not float(found.fun) < min(_EXPLAINED, _OF_SHEET * left(_THIN)):
        return None
    return Tank(depth, DeepTank(depth, angles, pattern, electrode=_ELECTRODE))


def _distances(pattern: DrivePattern, used: Mask) -> list[NDArray[np.int64]]:
    """Used readings, counted in order, by the distance round the ring between driven and measured pair."""
    drive, measure = np.nonzero(used)
    count = pattern.electrode_count
    first = (
        np.array([pair[0] for pair in pattern.drive])[drive],
        np.array([pair[0] for pair in pattern.measure])[measure],
    )
    apart = (first[1] - first[0]) % count
    apart = np.minimum(apart, count - apart)
    return [np.flatnonzero(apart == one) for one in np.unique(apart)]
