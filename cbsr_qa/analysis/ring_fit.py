"""Frames of a ring of resistors against its closed form: gain, offset, leads, and what is left of each reading."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.frames import ReadingFlag, VoltageUnit
from cbsr_qa.domain.patterns import DrivePattern
from cbsr_qa.domain.station_check import RingReadings
from cbsr_qa.forward.resistor_ring import lead_readings, ring_impedance, ring_readings

Array = NDArray[np.float64]

#: Readings that ought to be smaller than this share of the largest are held against it instead of themselves.
_SMALLEST: Final = 1e-3
#: Flags of readings that say nothing of the ring.
_BAD: Final = int(ReadingFlag.SATURATED | ReadingFlag.COMPLIANCE | ReadingFlag.MISSING)


@dataclass(frozen=True, slots=True, eq=False)
class RingFit:
    """What frames of a ring come to.

    A mean reading is (1 + gain error) × closed form × current + offset + what the leads add + its residual; fitted by
    least squares over all readings without a flag, each relative to its size.

    Parameters
    ----------
    expected, mean, noise : (drives, measures) the closed form, the mean over the frames, and the standard deviation
        over them, in the frames' unit. Where that is no volt or the current is not known, the closed form is scaled
        to the readings.
    used : (drives, measures) bool; readings without a flag in any frame.
    flags : (drives, measures) uint8; what was flagged in any frame.
    gain_error : as a fraction; None where nobody knows volts or current.
    offset : common to all readings, in their unit; None where the pattern cannot tell it from the gain.
    lead_ohm : (electrodes,) as the station reads them, gain error and all; None where the pattern cannot tell them,
        or nobody knows volts or current.
    residual : (drives, measures) as a fraction of the expected reading.
    """

    expected: Array
    mean: Array
    noise: Array
    used: NDArray[np.bool_]
    flags: NDArray[np.uint8]
    gain_error: float | None
    offset: float | None
    lead_ohm: Array | None
    residual: Array

    def relative(self, values: Array) -> Array:
        """Return values as a fraction of the expected readings."""
        return values / _sizes(self.expected)


def fit_ring(ring: RingReadings, pattern: DrivePattern) -> RingFit:
    """Hold frames of a ring against its closed form.

    Raises
    ------
    NumericsError
        If the ring does not fit the pattern, there are fewer than two frames or no current, or hardly a reading is
        without a flag.
    """
    frames = ring.frames
    if len(frames) < 2:
        raise NumericsError("one frame of a ring says nothing of noise", remedy="take two or more")
    if frames.current_A == 0:
        raise NumericsError("the frames were taken without a current", remedy="see that the source is on")
    flags = np.bitwise_or.reduce(frames.flags, axis=0)
    used = (flags & _BAD) == 0
    closed = ring_readings(ring.resistances_ohm, pattern)
    mean = frames.voltages.mean(axis=0)
    absolute = frames.unit is VoltageUnit.VOLT and frames.current_A is not None
    current = frames.current_A if absolute and frames.current_A is not None else 1.0
    found, leads_fitted, offset_fitted = _solve(current * closed, current * lead_readings(pattern), mean, used)
    gain, offset, leads = found[0], found[1], found[2:]
    expected = current * closed if absolute else gain * closed
    fitted = gain * current * closed + offset + current * lead_readings(pattern) @ leads
    return RingFit(
        expected=expected,
        mean=mean,
        noise=frames.voltages.std(axis=0, ddof=1),
        used=used,
        flags=flags,
        gain_error=gain - 1 if absolute else None,
        offset=offset if offset_fitted else None,
        lead_ohm=leads if leads_fitted and absolute else None,
        residual=np.where(used, mean - fitted, 0.0) / _sizes(expected),
    )


def exchanged(ring: RingReadings, pattern: DrivePattern, *, within: float) -> tuple[int, int] | None:
    """Return two electrodes that explain all readings if they are taken as exchanged; None where no two do.

    Parameters
    ----------
    within : the largest residual that counts as explained, as a fraction.
    """
    impedance = ring_impedance(ring.resistances_ohm)
    driven, measured = pattern.drive_currents(), pattern.measure_matrix()
    frames = ring.frames
    used = (np.bitwise_or.reduce(frames.flags, axis=0) & _BAD) == 0
    mean, leads = frames.voltages.mean(axis=0), lead_readings(pattern)
    current = frames.current_A or 1.0
    best: tuple[float, tuple[int, int]] | None = None
    for pair in combinations(range(pattern.electrode_count), 2):
        order = np.arange(pattern.electrode_count)
        order[list(pair)] = pair[::-1]
        closed = current * (driven.T @ impedance[np.ix_(order, order)] @ measured)
        (gain, offset, *ohm), _, _ = _solve(closed, current * leads, mean, used)
        left = mean - gain * closed - offset - current * leads @ np.array(ohm)
        worst = float(np.abs(np.where(used, left / _sizes(gain * closed), 0.0)).max())
        if worst <= within and (best is None or worst < best[0]):
            best = worst, pair
    return None if best is None else best[1]


def _solve(closed: Array, leads: Array, mean: Array, used: NDArray[np.bool_]) -> tuple[Array, bool, bool]:
    """Fit gain, offset and leads; leads, then the offset, are left at zero where the pattern cannot tell them.

    Returns
    -------
    (2 + electrodes,) the fit, and whether leads and offset are part of it.
    """
    size = _sizes(closed)[used]
    columns = np.column_stack([closed[used], np.ones(size.size), leads[used]]) / size[:, None]
    wanted = mean[used] / size
    found = np.zeros(columns.shape[1])
    for count in (len(found), 2, 1):
        part = columns[:, :count]
        scale = np.linalg.norm(part, axis=0)
        if size.size > count and (scale > 0).all() and np.linalg.matrix_rank(part / scale) == count:
            found[:count] = np.linalg.lstsq(part / scale, wanted, rcond=None)[0] / scale
            return found, count > 2, count > 1
    raise NumericsError(
        f"{int(used.sum())} of {used.size} readings of the ring are without a flag, too few to fit a gain",
        remedy="see that the ring is connected, and lower the drive current where it is at compliance",
    )


def _sizes(expected: Array) -> Array:
    """What deviations are relative to: the reading's own size, or a little where it ought to be none."""
    magnitude = np.abs(expected)
    sizes: Array = np.maximum(magnitude, _SMALLEST * magnitude.max())
    return sizes


def pair_words(pattern: DrivePattern, reading: Sequence[int]) -> str:
    """Name a reading by its electrodes: ``driven 3–4, measured 7–8``."""
    (source, sink), (plus, minus) = pattern.drive[reading[0]], pattern.measure[reading[1]]
    return f"driven {source}–{sink}, measured {plus}–{minus}"
