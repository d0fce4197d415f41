"""Hard cases of readings: offsets a million times the signal, units, precision, dead channels."""

from dataclasses import replace
from fractions import Fraction
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.defects.channels import find_faults
from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, ScanKind, VoltageUnit
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.readings import ReadingFold, reading_noise
from cbsr_qa.eit.inverse.scaling import changes, scale_doubts, scale_of
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.exact import relative_difference
from cbsr_qa.studies.hard_cases.sheets import (
    IMAGE_MM,
    make_usual_problem,
    make_usual_sensor,
    mask_electrodes,
    prepare_method,
)

AREA: Final = Area("readings")
_SEED: Final = 20261123
_METHOD: Final = "gauss-newton-noser"
_SIGNAL: Final = 1e-4  # a light touch, of a reading


def _frames() -> tuple[ImagingProblem, Array, Array]:
    """The usual problem, a reference frame [V] and one of a load (drives, measures)."""
    problem = make_usual_problem()
    reference = np.zeros(problem.used.shape)
    reference[problem.used] = 1e-3 * problem.reference
    random = np.random.default_rng(_SEED)
    changed = reference * (1 + _SIGNAL * random.standard_normal(reference.shape))
    return problem, reference, changed


def _change(problem: ImagingProblem, frame: Array, reference: Array, scale: float) -> Array:
    """(V − V_ref)/s of the used readings in whole fractions, rounded once."""
    return np.array(
        [
            float((Fraction(voltage) - Fraction(unloaded)) / Fraction(scale))
            for voltage, unloaded in zip(frame[problem.used].tolist(), reference[problem.used].tolist(), strict=True)
        ]
    )


def _change_condition(problem: ImagingProblem, frame: Array, reference: Array, offset: float = 0.0) -> float:
    """What relative changes of readings on an offset make of their difference."""
    size = np.linalg.norm((np.abs(frame) + np.abs(reference) + 2 * offset)[problem.used])
    return float(size / np.linalg.norm((frame - reference)[problem.used]))


def _offset(times: float) -> Answer:
    """Changes of readings that lie on an offset, in units of the signal; truth without the offset."""
    problem, reference, changed = _frames()
    signal = float(np.abs(changed - reference).max())
    offset = times * signal
    scale = scale_of(reference, problem)
    computed = changes((changed + offset)[None], reference + offset, problem, scale)[0]
    exact = _change(problem, changed, reference, scale)
    return answer_from_condition(
        relative_difference(computed, exact), _change_condition(problem, changed, reference, offset)
    )


def _image_in_units(factor: float) -> Answer:
    """Image of frames in another unit: the scale of the sensor takes it out."""
    problem, reference, changed = _frames()
    method = prepare_method(_METHOD, problem, {})
    images = []
    for unit in (1.0, factor):
        scale = scale_of(unit * reference, problem)
        images.append(method.images(changes((unit * changed)[None], unit * reference, problem, scale))[0])
    return answer_from_condition(
        relative_difference(images[1], images[0]), _change_condition(problem, changed, reference)
    )


def _noise(offset: float, beginning_s: float) -> Answer:
    """Noise of readings under an offset, and long after the clock began: both change nothing.

    Noise is of whole multiples of 2⁻³⁰, so that nothing is lost where the offset is added.
    """
    random = np.random.default_rng(_SEED)
    noise = np.round(random.standard_normal((30, 40)) * 2**10) / 2**30
    time_s = np.arange(30) / 4.0
    variance = reading_noise(noise, time_s).variance
    computed = reading_noise(noise + offset, time_s + beginning_s).variance
    condition = offset / float(noise.std()) + beginning_s / 7.5
    return answer_from_condition(relative_difference(computed, variance), condition)


_WHOLE: Final = "the same numbers, as whole fractions"


@AREA.against(_WHOLE)
def offset_of_1e6_signals() -> Answer:
    """All readings lie on an offset a million times as large as what a load changes."""
    return _offset(1e6)


@AREA.against(_WHOLE)
def offset_of_1e10_signals() -> Answer:
    """All readings lie on an offset ten thousand million times the change: six digits of it are left."""
    return _offset(1e10)


@AREA.against("the run warns where there is an offset, and only there")
def scale_from_an_offset_of_1e6_signals() -> Answer:
    """The unloaded frame lies on such an offset, and changes are to be taken over its scale."""
    problem, reference, _ = _frames()
    offset = 1e6 * _SIGNAL * float(np.abs(reference).max())
    is_wrong = [bool(scale_doubts(reference, problem)), bool(scale_doubts(-reference, problem))]
    is_wrong += [not scale_doubts(reference + sign * offset, problem) for sign in (-1, 1)]
    return Answer(float(sum(is_wrong)), 0.0, unit="wrong statements", note="the bound is zero")


@AREA.against("the noise without the offset, exactly")
def noise_under_an_offset_of_1e6() -> Answer:
    """Noise of a microvolt on readings of a volt, whose variance is small beside their square."""
    return _noise(1.0, 0.0)


@AREA.against("the noise with times from zero, exactly")
def noise_fifty_years_after_zero() -> Answer:
    """The same with time stamps that count seconds from 1970."""
    return _noise(1.0, 1.7e9)


@AREA.against("the image of the same frames in volts")
def volts_of_1e_12() -> Answer:
    """Frames whose readings are 1e-12 of the usual ones."""
    return _image_in_units(1e-12)


@AREA.against("the image of the same frames in volts")
def volts_of_1e12() -> Answer:
    """Frames whose readings are 1e12 of the usual ones."""
    return _image_in_units(1e12)


@AREA.against(_WHOLE)
def single_precision_frames() -> Answer:
    """Frames stored in single precision: the change must be taken in double."""
    problem, reference, changed = _frames()
    single: NDArray[Any] = changed.astype(np.float32)
    single_reference: NDArray[Any] = reference.astype(np.float32)
    scale = scale_of(reference, problem)
    computed = changes(single[None], single_reference, problem, scale)[0]
    exact = _change(problem, single.astype(np.float64), single_reference.astype(np.float64), scale)
    lost = relative_difference(computed, _change(problem, changed, reference, scale))
    note = f"what the format itself has lost of the change is {lost:.1e}"
    return answer_from_condition(relative_difference(computed, exact), 1.0, note=note)


@AREA.against("the difference of whole numbers")
def counts_at_both_ends_of_16_bits() -> Answer:
    """Integer counts whose difference does not fit the type they come in."""
    problem = make_usual_problem()
    low, high = np.iinfo(np.int16).min, np.iinfo(np.int16).max
    reference: NDArray[Any] = np.full(problem.used.shape, low, dtype=np.int16)
    frame: NDArray[Any] = np.full((1, *problem.used.shape), high, dtype=np.int16)
    computed = changes(frame, reference, problem, 1.0)[0]
    exact = np.full(len(computed), float(int(high) - int(low)))
    return Answer(relative_difference(computed, exact), 0.0, note="the bound is zero: whole numbers")


@AREA.against(_WHOLE)
def frame_of_zeros() -> Answer:
    """A frame that is all zero, as when the source is off."""
    problem, reference, _ = _frames()
    scale = scale_of(reference, problem)
    computed = changes(np.zeros((1, *reference.shape)), reference, problem, scale)[0]
    exact = _change(problem, np.zeros_like(reference), reference, scale)
    return answer_from_condition(relative_difference(computed, exact), 1.0)


@AREA.against("the image with zeros in these channels")
def nonsense_in_masked_channels() -> Answer:
    """The channels of an open electrode hold NaN, infinity and 1e300, and are masked."""
    sensor = make_usual_sensor()
    is_used = mask_electrodes(sensor, (5,))
    problem = imaging_problem(sensor, used=is_used, image_size_mm=IMAGE_MM)
    method = prepare_method(_METHOD, problem, {})
    _, reference, changed = _frames()
    images = []
    for nonsense in (np.zeros(3), np.array([np.nan, np.inf, 1e300])):
        frames = [reference.copy(), changed.copy()]
        for frame in frames:
            frame[~is_used] = np.resize(nonsense, int((~is_used).sum()))
        scale = scale_of(frames[0], problem)
        images.append(method.images(changes(frames[1][None], frames[0], problem, scale))[0])
    return Answer(float(np.abs(images[1] - images[0]).max()), 0.0, note="the bound is zero: they are not looked at")


@AREA.against("weighted means as whole fractions")
def reciprocal_readings_twelve_decades_apart() -> Answer:
    """Reciprocal readings with noise variances up to twelve decades apart."""
    plain_problem = make_usual_problem()
    decades = np.random.default_rng(_SEED).permutation(np.linspace(-5.9, 5.9, len(plain_problem.reference)))
    problem = replace(plain_problem, noise_variance=10**decades)
    readings = np.random.default_rng(_SEED + 1).standard_normal(len(decades))
    fold = ReadingFold.from_problem(problem)
    computed = fold.fold(readings[None])[0]
    weights = [1 / Fraction(value) for value in (10**decades).tolist()]
    weighted_sums, weight_sums, absolute_sums = ([Fraction(0)] * len(computed) for _ in range(3))
    for group, sign, weight, reading in zip(
        fold.group.tolist(), fold.sign.tolist(), weights, readings.tolist(), strict=True
    ):
        weighted_sums[group] += weight * Fraction(sign) * Fraction(reading)
        absolute_sums[group] += weight * abs(Fraction(reading))
        weight_sums[group] += weight
    exact = np.array(
        [float(value / denominator) for value, denominator in zip(weighted_sums, weight_sums, strict=True)]
    )
    condition = max(
        float(absolute_sum / abs(value)) for absolute_sum, value in zip(absolute_sums, weighted_sums, strict=True)
    )
    error = float(np.abs(computed / exact - 1).max())
    return answer_from_condition(error, condition)


@AREA.against("the channels that were made so")
def saturated_stuck_and_missing() -> Answer:
    """One channel at the source's limit in every tenth frame, one that never changes, one not recorded."""
    sensor = make_usual_sensor()
    random = np.random.default_rng(_SEED)
    voltages = 1.0 + 1e-3 * random.standard_normal((60, *sensor.pattern.shape))
    flags = np.zeros(voltages.shape, dtype=np.uint8)
    flags[::10, 2, 7] = ReadingFlag.COMPLIANCE.value
    flags[:, 4, 9] = ReadingFlag.MISSING.value
    voltages[:, 4, 9] = 0.0
    voltages[:, 11, 1] = 1.0005
    faults = find_faults(FrameBlock(np.arange(60) / 4.0, voltages, flags, VoltageUnit.VOLT, 1e-3), ScanKind.FULL)
    expected_bad = np.zeros(sensor.pattern.shape, dtype=np.bool_)
    for channel in ((2, 7), (4, 9), (11, 1)):
        expected_bad[channel] = True
    return Answer(float((faults.bad != expected_bad).sum()), 0.0, unit="channels", note="the bound is zero")


@AREA.refuses(NumericsError, "the refusal, with what to check")
def reference_of_zeros() -> None:
    """The unloaded frame is all zero: there is no scale to take changes over."""
    problem, reference, _ = _frames()
    scale_of(np.zeros_like(reference), problem)


@AREA.refuses(NumericsError, "the refusal, by the reading")
def reference_with_nan() -> None:
    """A reading in use is NaN."""
    problem, reference, _ = _frames()
    reference[0, 2] = np.nan
    scale_of(reference, problem)


@AREA.refuses(NumericsError, "the refusal, by the type")
def complex_voltages() -> None:
    """Phasors where magnitudes are needed: a cast would drop the imaginary part."""
    problem, reference, _ = _frames()
    phasors: Any = reference * (1 + 1e-3j)
    scale_of(phasors, problem)


@AREA.refuses(RefusedError, "the refusal, before it is stored")
def frame_with_nan() -> None:
    """A driver hands over NaN."""
    voltages = np.ones((2, 16, 16))
    voltages[1, 3, 5] = np.nan
    FrameBlock(np.arange(2.0), voltages, np.zeros(voltages.shape, dtype=np.uint8), VoltageUnit.VOLT, 1e-3)


@AREA.refuses(NumericsError, "the refusal, by how many are left and needed")
def seven_readings_left() -> None:
    """So many channels are masked that seven independent readings are left for two thousand elements."""
    is_used = np.zeros(make_usual_sensor().pattern.shape, dtype=np.bool_)
    is_used[0, 2:9] = True
    imaging_problem(make_usual_sensor(), used=is_used, image_size_mm=IMAGE_MM)


@AREA.refuses(NumericsError, "the refusal, by the readings left")
def eleven_electrodes_off() -> None:
    """Eleven electrodes have come off: three independent readings are left, and any image would be guessed."""
    sensor = make_usual_sensor()
    imaging_problem(sensor, used=mask_electrodes(sensor, tuple(range(11))), image_size_mm=IMAGE_MM)


@AREA.refuses(NumericsError, "the refusal, with what to do instead")
def no_noise_at_all() -> None:
    """Every reading is the same in all frames."""
    reading_noise(np.ones((30, 40)), np.arange(30.0))
