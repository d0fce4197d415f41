"""Frames of one sensor as changes of its readings, without readings that say nothing. Numpy alone."""

from collections.abc import Iterator
from copy import copy
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.calibration.force.faults import FaultFinder
from cbsr_qa.calibration.force.inverse import NO_FORCE, Flag
from cbsr_qa.calibration.runtime.fewer_readings import (
    FEWEST_ROWS,
    drop_readings,
    ignore_offset,
    reading_noise,
)
from cbsr_qa.calibration.runtime.spikes import SpikeFilter
from cbsr_qa.domain.errors import CalibrationError, NumericsError
from cbsr_qa.domain.numbers import Array, Indices, Mask, real_numbers
from cbsr_qa.domain.results import calibration as record
from cbsr_qa.domain.results.calibration import ForceModel

#: A frame is from another sensor if its readings as a whole are further than this from the reference's (relative),
#: and further than the second from it where one offset is taken off all readings.
_FOREIGN: Final = 0.5
_FOREIGN_LEVEL: Final = 0.1
#: Number of faults with a cached model.
_FAULTS: Final = 4


class SensorFrames:
    """The readings of one sensor's calibration.

    CalibrationError if it has no force model.
    """

    def __init__(self, issued: record.Calibration) -> None:
        if issued.force is None:
            raise CalibrationError(
                f"calibration {issued.calibration} of sensor {issued.sensor.serial} holds no force model:"
                f" {issued.no_force}",
                remedy="calibrate the sensor again: run a recipe whose calibration phases press three places or more",
            )
        self.issued = issued
        used_mask, pattern = issued.reconstruction.problem.used, issued.reconstruction.problem.sensor_type.pattern
        pairs = np.array([(*pattern.drive[d], *pattern.measure[m]) for d, m in np.argwhere(used_mask)])
        self._find_faults = FaultFinder(pairs, issued.reference[used_mask], reading_noise(issued.force.merging))
        self._without: dict[bytes, Self] = {}
        self._level: Self | None = None
        self._fewer = False
        self._use(issued.force, used_mask)

    def _use(self, model: ForceModel, used: Mask) -> None:
        """Use a model of some readings, (drives, measures) bool."""
        self._used = used
        self._reference: Array = self.issued.reference[used]
        self._without_spikes = SpikeFilter(
            self.issued.reconstruction.problem.sensor_type.pattern, used, model.merging
        )
        self._compare(model)

    def _compare(self, model: ForceModel) -> None:
        """Compare frames with the templates of a model."""
        self.model: ForceModel = model
        self._merging: Array = np.ascontiguousarray(model.merging.T)

    def rows(self, frames: ArrayLike, *, current_A: float | None = None) -> tuple[Array, Indices]:
        """Changes of frames as rows (n, r) of unit noise, and flags (n,), as in :meth:`changes`."""
        changes, flags = self.changes(frames, current_A=current_A)
        rows: Array = changes @ self._merging
        return rows, flags

    def changes(self, frames: ArrayLike, *, current_A: float | None = None) -> tuple[Array, Indices]:
        """Changes of frames (n, m) in the used readings [V], spikes replaced, and flags (n,).

        Changes of unusable frames are zero; readings to be left out are flagged, and not left out. Parameters and
        errors as for :meth:`force`.
        """
        voltages = self.voltages(frames, current_A)
        changes, flags = self.changes_of(voltages)
        return changes, flags | self._find_faults(voltages[:, self._used]).flags

    def voltages(self, frames: ArrayLike, current_A: float | None) -> Array:
        """Frames (n, drives, measures) at the calibration's current [V]."""
        voltages = volts(frames)
        shape = self.issued.reference.shape
        if voltages.shape[-2:] != shape or voltages.ndim not in (2, 3):
            raise CalibrationError(
                f"frames of shape {voltages.shape} are not of sensor {self.issued.sensor.serial}",
                remedy=f"its frames are (drives, measures) = {shape}, one or many",
            )
        if current_A is not None:
            if not (isinstance(current_A, int | float | np.number) and np.isfinite(current_A) and current_A > 0):
                raise CalibrationError(f"a drive current of {current_A} A is not a positive number")
            voltages = voltages * (self.issued.current_A / current_A)
        return voltages.reshape(-1, *shape)

    def changes_of(self, voltages: Array) -> tuple[Array, Indices]:
        """Changes of :meth:`changes` for :meth:`voltages` whose readings can all be used."""
        changes = voltages[:, self._used] - self._reference
        flags = np.zeros(len(changes), dtype=np.int64)
        readable_mask = np.isfinite(changes).all(axis=1) & (len(self._merging.T) >= FEWEST_ROWS)
        flags[~readable_mask] |= Flag.UNREADABLE
        changes[~readable_mask] = 0
        flags[self._without_spikes(changes)] |= Flag.SPIKE
        largest_square = _FOREIGN**2 * float(self._reference @ self._reference)
        foreign_mask = ~(np.einsum("nm,nm->n", changes, changes) <= largest_square)
        if foreign_mask.any():
            level = changes[foreign_mask] - np.median(changes[foreign_mask], axis=1, keepdims=True)
            foreign_mask[foreign_mask] = (
                np.einsum("nm,nm->n", level, level) > largest_square * (_FOREIGN_LEVEL / _FOREIGN) ** 2
            )
        flags[foreign_mask] |= Flag.OTHER_SENSOR
        changes[flags & NO_FORCE != 0] = 0
        return changes, flags

    def sound_parts(self, voltages: Array) -> Iterator[tuple[Self, Indices, Indices]]:
        """Frames (n, drives, measures) [V] by the readings to be left out.

        Yields
        ------
        This calibration for what is left, the numbers of its frames (k,), and their flags (k,) for what is not.
        """
        faults = self._find_faults(voltages[:, self._used])
        if not faults.flags.any():
            yield self, np.arange(len(voltages)), faults.flags
            return
        patterns, number = np.unique(faults.left_out, axis=0, return_inverse=True)
        for pattern, left_out in enumerate(patterns):
            frame_indices = np.flatnonzero(number.ravel() == pattern)
            yield self._with(~left_out), frame_indices, faults.flags[frame_indices]

    def _with(self, kept: Mask) -> Self:
        if kept.all():
            return self
        key = kept.tobytes()
        if key not in self._without:
            while len(self._without) >= _FAULTS:
                self._without.pop(next(iter(self._without)))
            reduced, used_mask = copy(self), self._used.copy()
            used_mask[used_mask] = kept
            reduced._level, reduced._fewer = None, True
            reduced._use(drop_readings(self.model, kept), used_mask)
            self._without[key] = reduced
        return self._without[key]

    def level(self) -> Self:
        """Return this calibration for frames with an unknown offset on all readings."""
        if self._level is None:
            level = copy(self)
            level._compare(ignore_offset(self.model))
            self._level = level._level = level
        return self._level


def volts(frames: ArrayLike) -> Array:
    """Return frames as float64 with NaN for masked readings.

    NumericsError as :func:`read_frames`, and if a dataset's variable states another unit than volts.
    """
    if (unit := getattr(frames, "attrs", {}).get("units", "V")) != "V":
        raise NumericsError(f"the frames are in {unit}, not in volts", remedy="a calibration needs frames in volts")
    return read_frames(frames)


def read_frames(frames: ArrayLike) -> Array:
    """Return frames in any unit as float64 with NaN for masked readings.

    NumericsError if they are not real numbers: a cast would drop imaginary parts, parse text, reveal masked values.
    """
    if isinstance(frames, np.ma.MaskedArray):
        frames = np.ma.filled(frames.astype(np.result_type(frames.dtype, np.float64)), np.nan)
    return real_numbers(frames, "frames")
