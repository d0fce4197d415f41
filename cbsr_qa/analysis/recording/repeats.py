"""Repeated injections: a pair driven or measured several times a frame is one pair, with the mean of its readings."""

from dataclasses import replace

import numpy as np

from cbsr_qa.domain.numbers import Indices
from cbsr_qa.domain.readings.frames import UNUSABLE, FrameBlock, Recording
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import SensorType


def average_repeats(recording: Recording, sensor_type: SensorType) -> tuple[Recording, SensorType]:
    """Average repeated readings, frame by frame; the same objects where no pair repeats or the frames do not fit.

    Noise falls as the root of the number of sound readings: those flagged as unusable are not averaged. The readings'
    own times are left out, as a mean has none.
    """
    pattern = sensor_type.pattern
    drive, measure = _number_pairs(pattern.drive), _number_pairs(pattern.measure)
    distinct = DrivePattern(
        pattern.electrode_count, tuple(dict.fromkeys(pattern.drive)), tuple(dict.fromkeys(pattern.measure))
    )
    if distinct.shape == pattern.shape or recording.frames.voltages.shape[1:] != pattern.shape:
        return recording, sensor_type
    cell = (len(distinct.measure) * drive[:, None] + measure).ravel()
    frames, reference = (
        None if block is None else _average_readings(block, cell, distinct)
        for block in (recording.frames, recording.reference)
    )
    assert frames is not None
    return replace(recording, frames=frames, reference=reference), replace(sensor_type, pattern=distinct)


def _number_pairs(pairs: tuple[tuple[int, int], ...]) -> Indices:
    number = {pair: k for k, pair in enumerate(dict.fromkeys(pairs))}
    return np.array([number[pair] for pair in pairs], dtype=np.int64)


def _average_readings(block: FrameBlock, cell: Indices, pattern: DrivePattern) -> FrameBlock:
    """Mean over readings of one cell, (m,) numbers of cells of the pattern."""
    voltages, flags = block.voltages.reshape(len(block), -1), block.flags.reshape(len(block), -1)
    shape = (len(block), *pattern.shape)
    mean, joined_flags = np.empty(shape).reshape(len(block), -1), np.empty(shape, np.uint8).reshape(len(block), -1)
    for number in range(mean.shape[1]):
        of_cell = cell == number
        sound_mask = (flags[:, of_cell] & UNUSABLE) == 0
        sound_mask |= ~sound_mask.any(axis=1, keepdims=True)
        mean[:, number] = (voltages[:, of_cell] * sound_mask).sum(axis=1) / sound_mask.sum(axis=1)
        joined_flags[:, number] = np.bitwise_or.reduce(np.where(sound_mask, flags[:, of_cell], 0), axis=1)
    return replace(block, voltages=mean.reshape(shape), flags=joined_flags.reshape(shape), reading_time_s=None)
