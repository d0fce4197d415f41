"""Hard cases of readings: offsets a million times the signal, units, precision, dead channels."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cbsr_qa.analysis.recording import find_faults
from cbsr_qa.domain import CbsrError, NumericsError, RefusedError
from cbsr_qa.domain.readings import FrameBlock, ReadingFlag, ScanKind, VoltageUnit
from cbsr_qa.domain.results import ImagingProblem
from cbsr_qa.eit.inverse import ReadingFold, changes, imaging_problem, reading_noise, scale_doubts, scale_of
from cbsr_qa.studies.hard_cases.case import Answer, HardCase, conditioned_bound
from cbsr_qa.studies.hard_cases.sheets import IMAGE_MM, prepared, usual_problem, usual_sensor, without_electrodes

Array = NDArray[np.float64]

_AREA: Final = "readings"
_SEED: Final = 20261123
_METHOD: Final = "gauss-newton-noser"
_SIGNAL: Final = 1e-4  # a light touch, of a reading


def _frames() -> tuple[ImagingProblem, Array, Array]:
    """The usual problem, a reference frame [V] and one of a load (drives, measures)."""
    problem = usual_problem()
    reference = np.zeros(problem.used.shape)
    reference[problem.used] = 1e-3 * problem.reference
    random = np.random.default_rng(_SEED)
    changed = reference * (1 + _SIGNAL * random.standard_normal(reference.shape))
    return problem, reference, changed


def _change(problem: ImagingProblem, frame: Array, reference: Array, scale: float) -> Array:
    """(V − V_ref)/s of the used readings in whole fractions, rounded once."""
    return np.array(
        [
            float((Fraction(one) - Fraction(other)) / Fraction(scale))
            for one, other in zip(frame[problem.used].tolist(), reference[problem.used].tolist(), strict=True)
        ]
    )


def _apart(found: Array, exact: Array) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def _offset(times: float) -> Answer:
    """Changes of readings that lie on an offset, in units of the signal; truth without the offset."""
    problem, reference, changed = _frames()
    signal = float(np.abs(changed - reference).max())
    offset = times * signal
    scale = scale_of(reference, problem)
    found = changes((changed + offset)[None], reference + offset, problem, scale)[0]
    exact = _change(problem, changed, reference, scale)
    condition = float(
        np.linalg.norm((np.abs(changed) + np.abs(reference) + 2 * offset)[problem.used])
        / np.linalg.norm((changed - reference)[problem.used])
    )
    return Answer(_apart(found, exact), conditioned_bound(condition), condition)


def _in_units(factor: float) -> Answer:
    """Image of frames in another unit: the scale of the sensor takes it out."""
    problem, reference, changed = _frames()
    method = prepared(_METHOD, problem, {})
    images = []
    for unit in (1.0, factor):
        scale = scale_of(unit * reference, problem)
        images.append(method.images(changes((unit * changed)[None], unit * reference, problem, scale))[0])
    condition = float(
        np.linalg.norm((np.abs(changed) + np.abs(reference))[problem.used])
        / np.linalg.norm((changed - reference)[problem.used])
    )
    return Answer(_apart(images[1], images[0]), conditioned_bound(condition), condition)


def _single_precision() -> Answer:
    """Frames of single precision against the same numbers, subtracted as whole fractions."""
    problem, reference, changed = _frames()
    single: NDArray[Any] = changed.astype(np.float32)
    single_reference: NDArray[Any] = reference.astype(np.float32)
    scale = scale_of(reference, problem)
    found = changes(single[None], single_reference, problem, scale)[0]
    exact = _change(problem, single.astype(np.float64), single_reference.astype(np.float64), scale)
    lost = _apart(found, _change(problem, changed, reference, scale))
    note = f"what the format itself has lost of the change is {lost:.1e}"
    return Answer(_apart(found, exact), conditioned_bound(1.0), 1.0, note=note)


def _counts() -> Answer:
    """Counts at both ends of a converter of 16 bits, as the integers they come as."""
    problem = usual_problem()
    low, high = np.iinfo(np.int16).min, np.iinfo(np.int16).max
    reference: NDArray[Any] = np.full(problem.used.shape, low, dtype=np.int16)
    frame: NDArray[Any] = np.full((1, *problem.used.shape), high, dtype=np.int16)
    found = changes(frame, reference, problem, 1.0)[0]
    exact = np.full(len(found), float(int(high) - int(low)))
    return Answer(_apart(found, exact), 0.0, note="the bound is zero: whole numbers")


def _zeros() -> Answer:
    """A frame of nothing but zeros, as of a board that has lost its source, against −V_ref/s."""
    problem, reference, _ = _frames()
    scale = scale_of(reference, problem)
    found = changes(np.zeros((1, *reference.shape)), reference, problem, scale)[0]
    exact = _change(problem, np.zeros_like(reference), reference, scale)
    return Answer(_apart(found, exact), conditioned_bound(1.0), 1.0)


def _masked_nonsense() -> Answer:
    """Image where masked channels hold NaN, infinity and 1e300, against that where they hold zeros."""
    sensor = usual_sensor()
    used = without_electrodes(sensor, (5,))
    problem = imaging_problem(sensor, used=used, image_size_mm=IMAGE_MM)
    method = prepared(_METHOD, problem, {})
    _, reference, changed = _frames()
    images = []
    for nonsense in (np.zeros(3), np.array([np.nan, np.inf, 1e300])):
        frames = [reference.copy(), changed.copy()]
        for frame in frames:
            frame[~used] = np.resize(nonsense, int((~used).sum()))
        scale = scale_of(frames[0], problem)
        images.append(method.images(changes(frames[1][None], frames[0], problem, scale))[0])
    return Answer(float(np.abs(images[1] - images[0]).max()), 0.0, note="the bound is zero: they are not looked at")


def _noise(offset: float, beginning_s: float) -> Answer:
    """Noise of readings under an offset, and long after the clock began: both change nothing.

    Noise is of whole multiples of 2⁻³⁰, so that nothing is lost where the offset is added.
    """
    random = np.random.default_rng(_SEED)
    noise = np.round(random.standard_normal((30, 40)) * 2**10) / 2**30
    time_s = np.arange(30) / 4.0
    plain = reading_noise(noise, time_s).variance
    found = reading_noise(noise + offset, time_s + beginning_s).variance
    condition = offset / float(noise.std()) + beginning_s / 7.5
    return Answer(_apart(found, plain), conditioned_bound(condition), condition)


def _folded() -> Answer:
    """Means of reciprocal readings of which one is a million times noisier, against whole fractions."""
    plain = usual_problem()
    decades = np.random.default_rng(_SEED).permutation(np.linspace(-5.9, 5.9, len(plain.reference)))
    problem = replace(plain, noise_variance=10**decades)
    readings = np.random.default_rng(_SEED + 1).standard_normal(len(decades))
    fold = ReadingFold.of(problem)
    found = fold.fold(readings[None])[0]
    weights = [1 / Fraction(one) for one in (10**decades).tolist()]
    above, below, size = ([Fraction(0)] * len(found) for _ in range(3))
    for group, sign, weight, reading in zip(
        fold.group.tolist(), fold.sign.tolist(), weights, readings.tolist(), strict=True
    ):
        above[group] += weight * Fraction(sign) * Fraction(reading)
        size[group] += weight * abs(Fraction(reading))
        below[group] += weight
    exact = np.array([float(one / other) for one, other in zip(above, below, strict=True)])
    condition = max(float(all_ / abs(one)) for all_, one in zip(size, above, strict=True))
    error = float(np.abs(found / exact - 1).max())
    return Answer(error, conditioned_bound(condition), condition)


def _faults() -> Answer:
    """Channels found saturated, stuck and missing among noisy ones, against those that were made so."""
    sensor = usual_sensor()
    random = np.random.default_rng(_SEED)
    voltages = 1.0 + 1e-3 * random.standard_normal((60, *sensor.pattern.shape))
    flags = np.zeros(voltages.shape, dtype=np.uint8)
    flags[::10, 2, 7] = ReadingFlag.COMPLIANCE.value
    flags[:, 4, 9] = ReadingFlag.MISSING.value
    voltages[:, 4, 9] = 0.0
    voltages[:, 11, 1] = 1.0005
    faults = find_faults(FrameBlock(np.arange(60) / 4.0, voltages, flags, VoltageUnit.VOLT, 1e-3), ScanKind.FULL)
    made = np.zeros(sensor.pattern.shape, dtype=np.bool_)
    for channel in ((2, 7), (4, 9), (11, 1)):
        made[channel] = True
    return Answer(float((faults.bad != made).sum()), 0.0, unit="channels", note="the bound is zero")


def _doubts() -> Answer:
    """Whether references on an offset, and only these, are said to have a scale that means little."""
    problem, reference, _ = _frames()
    offset = 1e6 * _SIGNAL * float(np.abs(reference).max())
    wrong = [bool(scale_doubts(reference, problem)), bool(scale_doubts(-reference, problem))]
    wrong += [not scale_doubts(reference + sign * offset, problem) for sign in (-1, 1)]
    return Answer(float(sum(wrong)), 0.0, unit="wrong statements", note="the bound is zero")


def _scaled(frame: Callable[[Array], ArrayLike]) -> Answer:
    """Take the scale of a frame made of the reference."""
    problem, reference, _ = _frames()
    scale_of(np.asarray(frame(reference)), problem)
    return Answer(0.0, 0.0)


def _with_nan(reference: Array) -> Array:
    frame = reference.copy()
    frame[0, 2] = np.nan
    return frame


def _left(used: Callable[[], NDArray[np.bool_]]) -> Answer:
    imaging_problem(usual_sensor(), used=used(), image_size_mm=IMAGE_MM)
    return Answer(0.0, 0.0)


def _seven_readings() -> NDArray[np.bool_]:
    used = np.zeros(usual_sensor().pattern.shape, dtype=np.bool_)
    used[0, 2:9] = True
    return used


def _block_with_nan() -> Answer:
    voltages = np.ones((2, 16, 16))
    voltages[1, 3, 5] = np.nan
    FrameBlock(np.arange(2.0), voltages, np.zeros(voltages.shape, dtype=np.uint8), VoltageUnit.VOLT, 1e-3)
    return Answer(0.0, 0.0)


def _no_noise() -> Answer:
    reading_noise(np.ones((30, 40)), np.arange(30.0))
    return Answer(0.0, 0.0)


def _case(name: str, hard: str, run: Callable[[], Answer], truth: str) -> HardCase:
    return HardCase(name, _AREA, hard, truth, run)


def _refusal(
    name: str, hard: str, run: Callable[[], Answer], truth: str, refuses: type[CbsrError] = NumericsError
) -> HardCase:
    return HardCase(name, _AREA, hard, f"the refusal, {truth}", run, refuses=refuses)


_WHOLE: Final = "the same numbers, as whole fractions"

_NUMBERS: Final = (
    _case(
        "offset-of-1e6-signals",
        "All readings lie on an offset a million times as large as what a load changes.",
        partial(_offset, 1e6),
        _WHOLE,
    ),
    _case(
        "offset-of-1e10-signals",
        "All readings lie on an offset ten thousand million times the change: six digits of it are left.",
        partial(_offset, 1e10),
        _WHOLE,
    ),
    _case(
        "scale-from-an-offset-of-1e6-signals",
        "The unloaded frame lies on such an offset, and changes are to be taken over its scale.",
        _doubts,
        "the run warns where there is an offset, and only there",
    ),
    _case(
        "noise-under-an-offset-of-1e6",
        "Noise of a microvolt on readings of a volt, whose variance is small beside their square.",
        partial(_noise, 1.0, 0.0),
        "the noise without the offset, exactly",
    ),
    _case(
        "noise-fifty-years-after-zero",
        "The same with time stamps that count seconds from 1970.",
        partial(_noise, 1.0, 1.7e9),
        "the noise with times from zero, exactly",
    ),
    _case(
        "volts-of-1e-12",
        "Frames whose readings are 1e-12 of the usual ones.",
        partial(_in_units, 1e-12),
        "the image of the same frames in volts",
    ),
    _case(
        "volts-of-1e12",
        "Frames whose readings are 1e12 of the usual ones.",
        partial(_in_units, 1e12),
        "the image of the same frames in volts",
    ),
    _case(
        "single-precision-frames",
        "Frames stored in single precision: the change must be taken in double.",
        _single_precision,
        _WHOLE,
    ),
    _case(
        "counts-at-both-ends-of-16-bits",
        "Integer counts whose difference does not fit the type they come in.",
        _counts,
        "the difference of whole numbers",
    ),
    _case("frame-of-zeros", "A frame that is all zero, as when the source is off.", _zeros, _WHOLE),
    _case(
        "nonsense-in-masked-channels",
        "The channels of an open electrode hold NaN, infinity and 1e300, and are masked.",
        _masked_nonsense,
        "the image with zeros in these channels",
    ),
    _case(
        "reciprocal-readings-twelve-decades-apart",
        "Reciprocal readings with noise variances up to twelve decades apart.",
        _folded,
        "weighted means as whole fractions",
    ),
    _case(
        "saturated-stuck-and-missing",
        "One channel at the source's limit in every tenth frame, one that never changes, one not recorded.",
        _faults,
        "the channels that were made so",
    ),
)

_REFUSED: Final = (
    _refusal(
        "reference-of-zeros",
        "The unloaded frame is all zero: there is no scale to take changes over.",
        partial(_scaled, np.zeros_like),
        "with what to check",
    ),
    _refusal("reference-with-nan", "A reading in use is NaN.", partial(_scaled, _with_nan), "by the reading"),
    _refusal(
        "complex-voltages",
        "Phasors where magnitudes are needed: a cast would drop the imaginary part.",
        partial(_scaled, lambda frame: frame * (1 + 1e-3j)),
        "by the type",
    ),
    _refusal("frame-with-nan", "A driver hands over NaN.", _block_with_nan, "before it is stored", RefusedError),
    _refusal(
        "seven-readings-left",
        "So many channels are masked that seven independent readings are left for two thousand elements.",
        partial(_left, _seven_readings),
        "by how many are left and needed",
    ),
    _refusal(
        "four-electrodes-off",
        "Four electrodes have come off: what lies between the others would be guessed.",
        partial(_left, lambda: without_electrodes(usual_sensor(), (1, 5, 9, 13))),
        "by the electrodes",
    ),
    _refusal("no-noise-at-all", "Every reading is the same in all frames.", _no_noise, "with what to do instead"),
)

CASES: Final[tuple[HardCase, ...]] = (*_NUMBERS, *_REFUSED)
