"""Readings prepared for least squares: reciprocal pairs merged, rows scaled to unit noise; the load model."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.outlines import Disc
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.inverse.problem import NOMINAL_CONTACT_MM, make_uniform_model
from cbsr_qa.eit.loads.meshed_sheet import MeshedSheet
from cbsr_qa.eit.loads.pinned_disc import PinnedDisc
from cbsr_qa.eit.loads.round_load import RoundLoadModel

_MESH_SIZE: Final = 0.12  # edge length, of the radius: fields are evaluated on the edge, where meshes are finer


@lru_cache(maxsize=8)
def load_model(sensor_type: SensorType) -> RoundLoadModel:
    """Readings of the even sheet under a round load, at unit sheet conductance; made once per process.

    Exact fields for a disc with pins, finite elements for any other sheet or one with its own mesh.
    """
    round_sheet = isinstance(sensor_type.outline, Disc) and sensor_type.mesh is None
    if round_sheet and sensor_type.electrodes.kind is ElectrodeKind.PIN:
        sheet = PinnedDisc(sensor_type.radius_mm, sensor_type.electrodes, NOMINAL_CONTACT_MM)
        return RoundLoadModel(sheet, sensor_type.pattern)
    model = make_uniform_model(sensor_type, _MESH_SIZE)
    return RoundLoadModel(MeshedSheet(model, sensor_type.radius_mm), sensor_type.pattern)


#: A load has four unknowns; hardly more readings could not contradict them.
FEWEST_ROWS = 12


@dataclass(frozen=True, slots=True, eq=False)
class MergedReadings:
    """Reciprocal readings are one quantity measured twice: their weighted mean is a sufficient statistic.

    Parameters
    ----------
    used : (drives, measures) bool with m True entries, in C order.
    merging : (rows, m) maps changes of the used readings to rows of unit noise.
    drive, measure : (rows,) a reading of each row, for the model.
    weight : (rows,) factor of the model's value of that reading.
    """

    used: Mask
    merging: Array
    drive: Indices
    measure: Indices
    weight: Array

    def merge_changes(self, changes: Array) -> Array:
        """Rows (n, rows) of changes (n, m) of the used readings."""
        return changes @ self.merging.T

    def merge_frames(self, readings: Array) -> Array:
        """Rows (…, rows) of whole frames (…, drives, measures) of a reciprocal model."""
        return readings[..., self.drive, self.measure] * self.weight


def merge_reciprocal(pattern: DrivePattern, used: Mask, variance: Array) -> MergedReadings:
    """Merge reciprocal readings.

    Parameters
    ----------
    variance : (drives, measures) variance of the readings' changes, independent of each other; only those of used
        readings matter.

    Raises
    ------
    NumericsError
        If shapes disagree, a variance is not a positive finite number, or too few readings are left.
    """
    if used.shape != pattern.shape or variance.shape != pattern.shape:
        raise NumericsError(
            f"mask {used.shape} and variances {variance.shape} do not match frames of shape {pattern.shape}"
        )
    if not (np.isfinite(variance[used]) & (variance[used] > 0)).all():
        raise NumericsError(
            "the noise variance of a used reading is not a positive finite number",
            remedy="leave out stuck readings, or take more unloaded frames",
        )
    groups, signs = pattern.reading_groups()
    _, leading, row = np.unique(groups[used], return_index=True, return_inverse=True)
    if len(leading) < FEWEST_ROWS:
        raise NumericsError(
            f"only {len(leading)} independent readings are left; estimating a load needs at least {FEWEST_ROWS}",
            remedy="repair the masked channels",
        )
    precision = 1 / variance[used]
    total, sign = np.bincount(row, precision), signs[used]
    merging = np.zeros((len(leading), len(row)))
    merging[row, np.arange(len(row))] = sign * sign[leading][row] * precision / np.sqrt(total)[row]
    drive, measure = np.nonzero(used)
    return MergedReadings(used, merging, drive[leading], measure[leading], np.sqrt(total))
