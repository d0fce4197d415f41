"""Frames of a reference ring compared with its closed form: gain, offset, leads and residuals, one line each."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.plan import ReferenceRing
from cbsr_qa.domain.readings.frames import UNUSABLE, ReadingFlag, VoltageUnit
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, RingReadings
from cbsr_qa.domain.sensor.patterns import DrivePattern, find_shared_electrode
from cbsr_qa.eit.forward.closed_forms import lead_readings, ring_impedance, ring_readings

#: Readings expected below this share of the largest are compared with that share instead of themselves.
_SMALLEST: Final = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class RingFit:
    """Fit of a ring's frames.

    A mean reading is (1 + gain error) × closed form × current + offset + leads + residual; fitted by least squares
    over all readings without a flag, each relative to its size.

    Parameters
    ----------
    expected, mean, noise : (drives, measures) the closed form, the mean over the frames, and the standard deviation
        over them, in the frames' unit. If that is not volts or the current is unknown, the closed form is scaled to
        the readings.
    used : (drives, measures) bool; never flagged, and not of the open electrode.
    flags : (drives, measures) uint8; flags of all frames combined.
    gain_error : gain error as a fraction; None if volts or current are unknown.
    offset : common to all readings, in their unit; None if the pattern cannot distinguish it from the gain.
    lead_ohm : (electrodes,) as the station reads them, including its gain error; None if the pattern cannot determine
        them, or volts or current are unknown.
    residual : (drives, measures) as a fraction of the expected reading.
    open_electrode : the one that all drive pairs share of which every reading is flagged; None without one.
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
    open_electrode: int | None

    @property
    def flagged(self) -> NDArray[np.bool_]:
        """Readings with a flag (drives, measures)."""
        unusable: NDArray[np.bool_] = (self.flags & int(UNUSABLE)) != 0
        return unusable

    def relative(self, values: Array) -> Array:
        """Return values as a fraction of the expected readings."""
        return values / _scale_deviations(self.expected)


def fit_ring(ring: RingReadings, pattern: DrivePattern) -> RingFit:
    """Fit gain, offset and leads of a ring's frames to its closed form.

    Raises
    ------
    NumericsError
        If the ring does not fit the pattern, there are fewer than two frames or no current, or too few readings are
        never flagged.
    """
    frames = ring.frames
    if len(frames) < 2:
        raise NumericsError("one frame of a ring does not show noise", remedy="take two or more")
    if frames.current_A == 0:
        raise NumericsError("the frames were taken without a current", remedy="check that the source is on")
    flags = np.bitwise_or.reduce(frames.flags, axis=0)
    used_mask = (flags & int(UNUSABLE)) == 0
    opened = find_shared_electrode(pattern.list_silent_drives(~used_mask, np.ones_like(used_mask)))
    if opened is not None:
        used_mask &= ~pattern.touching([opened])
    closed = ring_readings(ring.resistances_ohm, pattern)
    mean = frames.voltages.mean(axis=0)
    absolute = frames.unit is VoltageUnit.VOLT and frames.current_A is not None
    current = frames.current_A if absolute and frames.current_A is not None else 1.0
    solution, leads_fitted, offset_fitted = _fit(current * closed, current * lead_readings(pattern), mean, used_mask)
    gain, offset, leads = solution[0], solution[1], solution[2:]
    expected = current * closed if absolute else gain * closed
    fitted_readings = gain * current * closed + offset + current * lead_readings(pattern) @ leads
    return RingFit(
        expected=expected,
        mean=mean,
        noise=frames.voltages.std(axis=0, ddof=1),
        used=used_mask,
        flags=flags,
        gain_error=gain - 1 if absolute else None,
        offset=offset if offset_fitted else None,
        lead_ohm=leads if leads_fitted and absolute else None,
        residual=np.where(used_mask, mean - fitted_readings, 0.0) / _scale_deviations(expected),
        open_electrode=opened,
    )


def find_exchanged_electrodes(ring: RingReadings, pattern: DrivePattern, *, within: float) -> tuple[int, int] | None:
    """Return two electrodes whose exchange explains all readings, or None.

    Parameters
    ----------
    within : largest residual after the exchange, as a fraction.
    """
    impedance = ring_impedance(ring.resistances_ohm)
    driven, measured = pattern.drive_currents(), pattern.measure_matrix()
    frames = ring.frames
    used_mask = (np.bitwise_or.reduce(frames.flags, axis=0) & int(UNUSABLE)) == 0
    mean, leads = frames.voltages.mean(axis=0), lead_readings(pattern)
    current = frames.current_A or 1.0
    best_exchange: tuple[float, tuple[int, int]] | None = None
    for pair in combinations(range(pattern.electrode_count), 2):
        order = np.arange(pattern.electrode_count)
        order[list(pair)] = pair[::-1]
        closed = current * (driven.T @ impedance[np.ix_(order, order)] @ measured)
        (gain, offset, *ohm), _, _ = _fit(closed, current * leads, mean, used_mask)
        residual = mean - gain * closed - offset - current * leads @ np.array(ohm)
        worst_residual = float(np.abs(np.where(used_mask, residual / _scale_deviations(gain * closed), 0.0)).max())
        if worst_residual <= within and (best_exchange is None or worst_residual < best_exchange[0]):
            best_exchange = worst_residual, pair
    return None if best_exchange is None else best_exchange[1]


def _fit(closed: Array, leads: Array, mean: Array, used: NDArray[np.bool_]) -> tuple[Array, bool, bool]:
    """Fit gain, offset and leads; leads, then the offset, stay zero where the pattern cannot determine them.

    Returns
    -------
    (2 + electrodes,) the fit, and whether it includes leads and offset.
    """
    size = _scale_deviations(closed)[used]
    columns = np.column_stack([closed[used], np.ones(size.size), leads[used]]) / size[:, None]
    scaled_readings = mean[used] / size
    solution = np.zeros(columns.shape[1])
    for count in (len(solution), 2, 1):
        leading_columns = columns[:, :count]
        scale = np.linalg.norm(leading_columns, axis=0)
        if size.size > count and (scale > 0).all() and np.linalg.matrix_rank(leading_columns / scale) == count:
            solution[:count] = np.linalg.lstsq(leading_columns / scale, scaled_readings, rcond=None)[0] / scale
            return solution, count > 2, count > 1
    raise NumericsError(
        f"{int(used.sum())} of {used.size} readings of the ring are without a flag, too few to fit a gain",
        remedy="check that the ring is connected, and lower the drive current where it is at compliance",
    )


def _scale_deviations(expected: Array) -> Array:
    """Scale of relative deviations: the reading's own size, or a small one where zero is expected."""
    magnitude = np.abs(expected)
    sizes: Array = np.maximum(magnitude, _SMALLEST * magnitude.max())
    return sizes


def pair_words(pattern: DrivePattern, reading: Sequence[int]) -> str:
    """Name a reading by its electrodes: ``driven 3–4, measured 7–8``."""
    (source, sink), (plus, minus) = pattern.drive[reading[0]], pattern.measure[reading[1]]
    return f"driven {source}–{sink}, measured {plus}–{minus}"


#: Subject of these lines.
RING: Final = "reference ring"
#: Factor by which readings across one pair must deviate more than elsewhere for the pair to be named.
_STANDS_OUT: Final = 3.0
_UNKNOWN: Final = "the frames are not in volts, or their current is not known"


def check_ring(ring: RingReadings, pattern: DrivePattern, allowed: ReferenceRing) -> tuple[CheckResult, ...]:
    """Judge frames of a ring: flags, gain, offset, leads, worst reading and noise, one line each.

    Parameters
    ----------
    ring : the frames and the ring's resistors.
    pattern : pattern of the sensor type the station is set up for.
    allowed : limits of the station file.
    """
    try:
        fit = fit_ring(ring, pattern)
    except NumericsError as error:
        return (CheckResult("readings", CheckOutcome.FAILED, said=error.reason, remedy=error.remedy, subject=RING),)
    return (
        _judge_flags(fit, pattern),
        _judge_gain(fit, allowed),
        _judge_offset(fit, allowed, str(ring.frames.unit)),
        _judge_leads(fit, allowed),
        _judge_worst(fit, ring, pattern, allowed),
        _judge_noise(fit, pattern, allowed),
    )


def _judge(name: str, ok: bool, value: float, unit: str, allowed: str, finding: str, remedy: str) -> CheckResult:
    """One judged line, with its remedy if it failed."""
    outcome = CheckOutcome.OK if ok else CheckOutcome.FAILED
    return CheckResult(name, outcome, value, unit, allowed, "" if ok else remedy, finding, RING)


def _skip_check(name: str, why: str) -> CheckResult:
    return CheckResult(name, CheckOutcome.NOT_DONE, said=why, subject=RING)


def _judge_flags(fit: RingFit, pattern: DrivePattern) -> CheckResult:
    count = int(fit.flagged.sum())
    finding = f"all {fit.used.size} readings are without a flag"
    if count:
        first_flagged = tuple(int(index) for index in np.argwhere(fit.flagged)[0])
        flag_name = ReadingFlag(int(fit.flags[first_flagged])).name or "flagged"
        finding = (
            f"{count} of {fit.used.size}; the first is {pair_words(pattern, first_flagged)}: {flag_name.lower()}"
        )
    remedy = "check that the ring is connected; lower the drive current or the ring's resistance"
    if fit.open_electrode is not None:
        finding += f"; all readings that electrode {fit.open_electrode} drives are flagged: it may be open"
        remedy = f"check plug, lead and switch of electrode {fit.open_electrode}"
    return _judge("flagged readings", not count, float(count), "1", "0", finding, remedy)


def _judge_gain(fit: RingFit, allowed: ReferenceRing) -> CheckResult:
    if fit.gain_error is None:
        return _skip_check("gain error", _UNKNOWN)
    limit = allowed.gain + allowed.tolerance
    finding = "readings over closed form × current, all together"
    remedy = "check the ring's resistance, then the source's current and the meter's calibration"
    ok, allowed_words = abs(fit.gain_error) <= limit, _describe_band(100 * limit, "%")
    return _judge("gain error", ok, 100 * fit.gain_error, "%", allowed_words, finding, remedy)


def _judge_offset(fit: RingFit, allowed: ReferenceRing, unit: str) -> CheckResult:
    if fit.offset is None:
        return _skip_check("offset", "the pattern cannot separate offset and gain")
    if fit.gain_error is None:
        return _judge("offset", True, fit.offset, unit, "", _UNKNOWN, "")
    ok, allowed_words = abs(fit.offset) <= allowed.offset_V, _describe_band(1e3 * allowed.offset_V, "mV")
    remedy = "zero the meter; look for a thermal voltage or a ground loop in the measuring pair"
    return _judge("offset", ok, 1e3 * fit.offset, "mV", allowed_words, "common to all readings", remedy)


def _judge_leads(fit: RingFit, allowed: ReferenceRing) -> CheckResult:
    name = "lead resistance"
    if fit.lead_ohm is None:
        return _skip_check(name, _UNKNOWN if fit.gain_error is None else "the pattern cannot separate leads and ring")
    worst_electrode = int(np.argmax(np.abs(fit.lead_ohm)))
    value = float(fit.lead_ohm[worst_electrode])
    finding = f"largest at electrode {worst_electrode}; mean of all {_format_number(float(fit.lead_ohm.mean()), 3)} Ω"
    ok, remedy = abs(value) <= allowed.lead_ohm, f"check plug, lead and switch of electrode {worst_electrode}"
    return _judge(name, ok, value, "ohm", _describe_band(allowed.lead_ohm, "Ω"), finding, remedy)


def _judge_worst(fit: RingFit, ring: RingReadings, pattern: DrivePattern, allowed: ReferenceRing) -> CheckResult:
    drive, measure = np.unravel_index(int(np.argmax(np.abs(fit.residual))), fit.residual.shape)
    residual, limit = float(fit.residual[drive, measure]), allowed.reading + allowed.tolerance
    ok, unit = abs(residual) <= limit, str(ring.frames.unit)
    mean, expected = float(fit.mean[drive, measure]), float(fit.expected[drive, measure])
    finding = f"{pair_words(pattern, (int(drive), int(measure)))}: {_format_number(mean)} {unit} where"
    finding += f" {_format_number(expected)} {unit} is expected; gain, offset and leads are removed"
    remedy = "" if ok else _find_cause(fit, ring, pattern, limit)
    return _judge("worst reading", ok, 100 * residual, "%", _describe_band(100 * limit, "%"), finding, remedy)


def _find_cause(fit: RingFit, ring: RingReadings, pattern: DrivePattern, limit: float) -> str:
    """Likely cause of deviating readings: two exchanged electrodes, or one bad resistor."""
    swapped = find_exchanged_electrodes(ring, pattern, within=limit)
    if swapped is not None:
        first, second = swapped
        return f"electrodes {first} and {second} are exchanged: swapping them fits all readings; correct their leads"
    # Half of the drives across a bad resistor deviate far more than the others.
    median_residuals = np.abs(np.median(fit.residual, axis=1))
    worst_pair = int(np.argmax(median_residuals))
    if median_residuals[worst_pair] > max(limit, _STANDS_OUT * float(np.median(median_residuals))):
        source, sink = pattern.drive[worst_pair]
        return f"readings driven across electrodes {source} and {sink} are off: check the resistor between them"
    return "check the resistors and the wiring of these electrodes"


def _judge_noise(fit: RingFit, pattern: DrivePattern, allowed: ReferenceRing) -> CheckResult:
    usable = pattern.usable() & fit.used
    judged_mask = usable if usable.any() else fit.used
    relative = np.where(judged_mask, fit.relative(fit.noise), 0.0)
    rms = float(np.sqrt(np.mean(relative[judged_mask] ** 2)))
    drive, measure = np.unravel_index(int(np.argmax(relative)), relative.shape)
    noisiest = f"{pair_words(pattern, (int(drive), int(measure)))} with {1e6 * relative[drive, measure]:.3g} ppm"
    finding = f"rms over {int(judged_mask.sum())} readings; the noisiest is {noisiest}"
    ok, allowed_words = rms <= allowed.noise, f"at most {1e6 * allowed.noise:.4g} ppm"
    return _judge(
        "noise of a reading",
        ok,
        1e6 * rms,
        "ppm",
        allowed_words,
        finding,
        "" if ok else _advise_on_noise(rms, allowed),
    )


def _advise_on_noise(rms: float, allowed: ReferenceRing) -> str:
    """Advice on noise that is constant in volts, where small readings make relative noise large."""
    enough_ohm = float(f"{1.05 * float(np.mean(allowed.resistance_ohm)) * rms / allowed.noise:.1e}")
    return (
        "look for loose plugs and mains hum; average longer; with a ring of"
        f" {enough_ohm:g} Ω and more the same noise would be allowed"
    )


def _format_number(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}g}".replace("-", "−")


def _describe_band(limit: float, unit: str) -> str:
    return f"−{limit:.4g} to {limit:.4g} {unit}"
