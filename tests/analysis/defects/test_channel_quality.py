"""Every reading of the rested sheet by itself: signal-to-noise ratio and reciprocity."""

import numpy as np
import pytest

from cbsr_qa.analysis.defects.quality import largest_by_reading, reciprocity_errors, signal_to_noise_dB
from cbsr_qa.domain.readings.frames import FrameBlock, VoltageUnit
from cbsr_qa.domain.sensor.patterns import DrivePattern, adjacent_pattern

PATTERN = adjacent_pattern(16)
USABLE = PATTERN.usable()


def _frames(voltages: np.ndarray) -> FrameBlock:
    return FrameBlock(
        2.5 * np.arange(len(voltages)), voltages, np.zeros(voltages.shape, np.uint8), VoltageUnit.VOLT, 1e-3
    )


def _reciprocal(seed: int = 1) -> np.ndarray:
    half = np.random.default_rng(seed).uniform(0.5, 1.5, USABLE.shape)
    return half + half.T


def test_each_reading_has_the_ratio_of_its_own_noise():
    random = np.random.default_rng(2)
    noise = np.geomspace(1e-4, 1e-2, 16)[:, None] * np.ones(16)
    level = _reciprocal()
    ratio = signal_to_noise_dB(_frames(level + noise * random.standard_normal((2000, 16, 16))))
    assert ratio == pytest.approx(20 * np.log10(level / noise), abs=0.7)


def test_silence_and_absence_are_infinite_not_undefined():
    voltages = np.tile(_reciprocal(), (20, 1, 1))
    voltages += 1e-3 * np.random.default_rng(3).standard_normal(voltages.shape)
    voltages[:, 3, 7], voltages[:, 4, 9] = 1.0, 0.0
    ratio = signal_to_noise_dB(_frames(voltages))
    assert ratio[3, 7] == ratio[4, 9] == np.inf
    voltages[:, 4, 9] = np.tile([1e-3, -1e-3, -1e-3, 1e-3], 5)
    assert signal_to_noise_dB(_frames(voltages))[4, 9] == -np.inf
    assert not np.isnan(ratio).any()


def test_two_frames_have_no_scatter():
    assert signal_to_noise_dB(_frames(np.ones((2, 16, 16)))) is None


def test_an_exchanged_pair_that_reads_otherwise_is_found_on_both_its_readings():
    frame = _reciprocal()
    frame[2, 9] *= 1.05
    pairs, errors = reciprocity_errors(frame, PATTERN, USABLE)
    assert len(pairs) == 104
    (worst,) = np.flatnonzero(errors > 1e-12)
    assert sorted(divmod(int(reading), 16) for reading in pairs[worst]) == [(2, 9), (9, 2)]
    rms = np.sqrt(np.mean(frame[USABLE] ** 2))
    assert errors[worst] == pytest.approx(0.05 / 1.05 * frame[2, 9] / rms)
    by_reading = largest_by_reading(pairs, errors, USABLE.shape)
    assert by_reading == pytest.approx(by_reading.T)
    assert by_reading[2, 9] == errors[worst]
    assert ((by_reading >= 0) == USABLE).all()


def test_what_is_not_usable_has_no_partner():
    usable = USABLE.copy()
    usable[2, 9] = False
    pairs, _ = reciprocity_errors(_reciprocal(), PATTERN, usable)
    assert len(pairs) == 103
    pattern = DrivePattern(6, ((0, 1), (1, 2)), ((3, 4), (4, 5)))
    pairs, errors = reciprocity_errors(np.ones((2, 2)), pattern, np.ones((2, 2), dtype=bool))
    assert pairs.shape == (0, 2)
    assert errors.size == 0
    assert reciprocity_errors(np.zeros((16, 16)), PATTERN, USABLE)[1].size == 0
