"""What the frames of a reference ring say of a station, line by line."""

from typing import Final

import numpy as np

from cbsr_qa.analysis.ring_fit import RingFit, exchanged, fit_ring, pair_words
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.frames import ReadingFlag
from cbsr_qa.domain.patterns import DrivePattern
from cbsr_qa.domain.plan import ReferenceRing
from cbsr_qa.domain.station_check import CheckOutcome, CheckResult, RingReadings

#: Subject of these lines.
RING: Final = "reference ring"
#: How much more than elsewhere readings across one pair must be off for the pair to be named.
_STANDS_OUT: Final = 3.0
_UNKNOWN: Final = "the frames are not in volts, or their current is not known"


def check_ring(ring: RingReadings, pattern: DrivePattern, allowed: ReferenceRing) -> tuple[CheckResult, ...]:
    """Judge frames of a ring: flags, gain, offset, leads, the worst reading and noise, a line for each.

    Parameters
    ----------
    ring : the frames and the resistors they are of.
    pattern : of the sensor type the station is set up for.
    allowed : limits of the station file.
    """
    try:
        fit = fit_ring(ring, pattern)
    except NumericsError as error:
        return (CheckResult("readings", CheckOutcome.FAILED, said=error.reason, remedy=error.remedy, subject=RING),)
    return (
        _flagged(fit, pattern),
        _gain(fit, allowed),
        _offset(fit, allowed, str(ring.frames.unit)),
        _leads(fit, allowed),
        _worst(fit, ring, pattern, allowed),
        _noise(fit, pattern, allowed),
    )


def _judged(ok: bool) -> CheckOutcome:
    return CheckOutcome.OK if ok else CheckOutcome.FAILED


def _flagged(fit: RingFit, pattern: DrivePattern) -> CheckResult:
    count = int((~fit.used).sum())
    said = f"all {fit.used.size} readings are without a flag"
    if count:
        first = tuple(int(index) for index in np.argwhere(~fit.used)[0])
        what = ReadingFlag(int(fit.flags[first])).name or "flagged"
        said = f"{count} of {fit.used.size}; the first is {pair_words(pattern, first)}: {what.lower()}"
    return CheckResult(
        "flagged readings",
        _judged(not count),
        value=float(count),
        unit="1",
        allowed="0",
        said=said,
        remedy="see that the ring is connected; lower the drive current or the ring's resistance" if count else "",
        subject=RING,
    )


def _gain(fit: RingFit, allowed: ReferenceRing) -> CheckResult:
    if fit.gain_error is None:
        return CheckResult("gain error", CheckOutcome.NOT_DONE, said=_UNKNOWN, subject=RING)
    ok = abs(fit.gain_error) <= allowed.gain + allowed.tolerance
    return CheckResult(
        "gain error",
        _judged(ok),
        value=100 * fit.gain_error,
        unit="%",
        allowed=_within(100 * (allowed.gain + allowed.tolerance), "%"),
        said="readings over closed form × current, all together",
        remedy="" if ok else "check the ring's resistance, then the source's current and the meter's calibration",
        subject=RING,
    )


def _offset(fit: RingFit, allowed: ReferenceRing, unit: str) -> CheckResult:
    if fit.offset is None:
        why = "the pattern cannot tell an offset from the gain"
        return CheckResult("offset", CheckOutcome.NOT_DONE, said=why, subject=RING)
    if fit.gain_error is None:
        return CheckResult("offset", CheckOutcome.OK, value=fit.offset, unit=unit, said=_UNKNOWN, subject=RING)
    ok = abs(fit.offset) <= allowed.offset_V
    return CheckResult(
        "offset",
        _judged(ok),
        value=1e3 * fit.offset,
        unit="mV",
        allowed=_within(1e3 * allowed.offset_V, "mV"),
        said="common to all readings",
        remedy="" if ok else "zero the meter; look for a thermal voltage or a ground loop in the measuring pair",
        subject=RING,
    )


def _leads(fit: RingFit, allowed: ReferenceRing) -> CheckResult:
    if fit.lead_ohm is None:
        why = _UNKNOWN if fit.gain_error is None else "the pattern cannot tell leads from the ring"
        return CheckResult("lead resistance", CheckOutcome.NOT_DONE, said=why, subject=RING)
    worst = int(np.argmax(np.abs(fit.lead_ohm)))
    ok = abs(fit.lead_ohm[worst]) <= allowed.lead_ohm
    return CheckResult(
        "lead resistance",
        _judged(ok),
        value=float(fit.lead_ohm[worst]),
        unit="ohm",
        allowed=_within(allowed.lead_ohm, "Ω"),
        said=f"largest at electrode {worst}; mean of all {_number(float(fit.lead_ohm.mean()), 3)} Ω",
        remedy="" if ok else f"check plug, lead and switch of electrode {worst}",
        subject=RING,
    )


def _worst(fit: RingFit, ring: RingReadings, pattern: DrivePattern, allowed: ReferenceRing) -> CheckResult:
    drive, measure = np.unravel_index(int(np.argmax(np.abs(fit.residual))), fit.residual.shape)
    residual, limit = float(fit.residual[drive, measure]), allowed.reading + allowed.tolerance
    ok, unit = abs(residual) <= limit, str(ring.frames.unit)
    words = pair_words(pattern, (int(drive), int(measure)))
    mean, expected = float(fit.mean[drive, measure]), float(fit.expected[drive, measure])
    said = f"{words}: {_number(mean)} {unit} where {_number(expected)} {unit} is expected"
    return CheckResult(
        "worst reading",
        _judged(ok),
        value=100 * residual,
        unit="%",
        allowed=_within(100 * limit, "%"),
        said=f"{said}; gain, offset and leads are taken out",
        remedy="" if ok else _cause(fit, ring, pattern, limit),
        subject=RING,
    )


def _cause(fit: RingFit, ring: RingReadings, pattern: DrivePattern, limit: float) -> str:
    """What explains readings that are off: two electrodes exchanged, or one pair that nothing driven across fits."""
    swapped = exchanged(ring, pattern, within=limit)
    if swapped is not None:
        first, second = swapped
        return f"electrodes {first} and {second} are exchanged: all readings fit then; put their leads right"
    # Half of what is driven across a bad resistor is off by far more than what is driven elsewhere.
    off = np.abs(np.median(fit.residual, axis=1))
    worst = int(np.argmax(off))
    if off[worst] > max(limit, _STANDS_OUT * float(np.median(off))):
        source, sink = pattern.drive[worst]
        return f"what is driven across electrodes {source} and {sink} is off: check the resistor between them"
    return "check the resistors and the wiring of these electrodes"


def _noise(fit: RingFit, pattern: DrivePattern, allowed: ReferenceRing) -> CheckResult:
    usable = pattern.usable() & fit.used
    which = usable if usable.any() else fit.used
    relative = np.where(which, fit.relative(fit.noise), 0.0)
    rms = float(np.sqrt(np.mean(relative[which] ** 2)))
    drive, measure = np.unravel_index(int(np.argmax(relative)), relative.shape)
    ok = rms <= allowed.noise
    noisiest = f"{pair_words(pattern, (int(drive), int(measure)))} with {1e6 * relative[drive, measure]:.3g} ppm"
    return CheckResult(
        "noise of a reading",
        _judged(ok),
        value=1e6 * rms,
        unit="ppm",
        allowed=f"at most {1e6 * allowed.noise:.4g} ppm",
        said=f"rms over {int(which.sum())} readings; the noisiest is {noisiest}",
        remedy="" if ok else _less_noise(rms, allowed),
        subject=RING,
    )


def _less_noise(rms: float, allowed: ReferenceRing) -> str:
    """What to do about noise: also small readings make it large, where it is the same in volts whatever is read."""
    enough_ohm = float(f"{1.05 * float(np.mean(allowed.resistance_ohm)) * rms / allowed.noise:.1e}")
    return (
        "look for loose plugs and mains hum; average longer; in the larger readings of a ring of"
        f" {enough_ohm:g} Ω and more the same noise would be allowed"
    )


def _number(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}g}".replace("-", "−")


def _within(limit: float, unit: str) -> str:
    return f"−{limit:.4g} to {limit:.4g} {unit}"
