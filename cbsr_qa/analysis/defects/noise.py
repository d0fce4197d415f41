"""Robust noise of a recording; steps are reported instead of averaged over."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.readings.frames import FrameBlock, VoltageUnit
from cbsr_qa.domain.results.findings import NoiseReport, NoiseStep

#: Standard deviation of a Gaussian over its median absolute deviation.
MAD_TO_SIGMA = 1.4826
#: Share of the largest steps excluded from the noise, and the mean of |N(0, 1)| without it: 2 (φ(0) − φ(q)) / 0.8
#: with q = 1.2816 the normal distribution's 90 % point.
_TRIMMED = 0.2
_TRIMMED_MEAN = 0.5586
#: Standard deviation of uniform rounding to whole counts.
_ROUNDING = 1 / np.sqrt(12)
#: A level step: at least half of the channels jump by this many times their noise within one frame, and stay.
_JUMP = 8.0
_STAY_FRAMES = 8
#: A noise step: the noise changes by at least this ratio for at least so many frames, with this significance.
_NOISE_RATIO = 1.5
_NOISE_FRAMES = 12
_NOISE_T = 8.0
_OUTLIER = 6.0
_MIN_QUIET_FRAMES = 4
_MIN_STRETCH_SHARE = 0.9  #: stretches at least this share of the longest count as equally long


def channel_noise(readings: Array, *, counts: bool) -> Array:
    """Rms noise of each channel from successive differences, robust against steps, drift and single outliers.

    Parameters
    ----------
    readings : (n, channels), n at least 2.
    counts : whether the values are whole counts; their noise is at least that of rounding.

    Returns
    -------
    (channels,) float64, in the readings' unit; never zero.
    """
    steps = np.diff(readings, axis=0)
    steps = np.sort(np.abs(steps - np.median(steps, axis=0)), axis=0)
    # The median would not do: for counts it takes few distinct values, and so would the noise.
    smaller_steps = steps[: max(1, round((1 - _TRIMMED) * len(steps)))]
    sigma = smaller_steps.mean(axis=0) / _TRIMMED_MEAN / np.sqrt(2)
    level = float(np.median(np.abs(readings))) if readings.size else 0.0
    least = _ROUNDING if counts else 1e-7 * level
    floored: Array = np.maximum(sigma, least or 1e-300)
    return floored


def find_steps(time_s: Array, readings: Array, sigma: Array) -> tuple[NoiseStep, ...]:
    """Changes of level or noise shared by most channels, in time order.

    Parameters
    ----------
    time_s : (n,). readings : (n, channels). sigma : (channels,) of :func:`channel_noise`.
    """
    if len(readings) < 2 * _STAY_FRAMES:
        return ()
    steps = [*_level_steps(time_s, readings, sigma), *_noise_steps(time_s, readings)]
    return tuple(sorted(steps, key=lambda step: step.time_s))


def _level_steps(time_s: Array, readings: Array, sigma: Array) -> list[NoiseStep]:
    jumps = np.abs(np.diff(readings, axis=0)) / sigma
    candidates = np.flatnonzero((jumps > _JUMP).mean(axis=1) >= 0.5) + 1
    steps: list[NoiseStep] = []
    last_frame = -_STAY_FRAMES
    for frame in candidates:
        level_before = np.median(readings[max(frame - _STAY_FRAMES, 0) : frame], axis=0)
        level_after = np.median(readings[frame : frame + _STAY_FRAMES], axis=0)
        if np.mean(np.abs(level_after - level_before) > _JUMP * sigma) >= 0.5:
            middle = float(time_s[frame - 1] + time_s[frame]) / 2
            step = NoiseStep(middle, "level", float(np.median(level_before)), float(np.median(level_after)))
            if steps and frame - last_frame < _STAY_FRAMES:
                # A step in the middle of a frame shows in two successive frames, and counts once.
                step = replace(step, before=steps.pop().before)
            steps.append(step)
            last_frame = int(frame)
    return steps


def _noise_steps(time_s: Array, readings: Array) -> list[NoiseStep]:
    spread = MAD_TO_SIGMA * np.median(np.abs(np.diff(readings, axis=0)), axis=1) / np.sqrt(2)
    if not (spread > 0).any():
        return []
    log = np.log(np.maximum(spread, 0.1 * spread[spread > 0].min()))
    cuts = sorted(_split(log, 0, len(log)))
    edges = [0, *cuts, len(log)]
    levels = [float(np.exp(np.median(log[a:b]))) for a, b in pairwise(edges)]
    return [
        NoiseStep(float(time_s[cut]), "noise", levels[k], levels[k + 1])
        for k, cut in enumerate(cuts)
        if abs(np.log(levels[k + 1] / levels[k])) > np.log(_NOISE_RATIO)
    ]


def _split(log: Array, start: int, end: int) -> list[int]:
    """Binary segmentation: cut where the two sides differ most, while the difference is significant."""
    n = end - start
    if n < 2 * _NOISE_FRAMES:
        return []
    segment = log[start:end]
    cuts = np.arange(_NOISE_FRAMES, n - _NOISE_FRAMES + 1)
    total = np.concatenate([[0.0], np.cumsum(segment)])
    difference = np.abs((total[n] - total[cuts]) / (n - cuts) - total[cuts] / cuts)
    scatter = max(MAD_TO_SIGMA * float(np.median(np.abs(np.diff(segment)))) / np.sqrt(2), 1e-12)
    statistic = difference / (scatter * np.sqrt(1 / cuts + 1 / (n - cuts)))
    best_index = int(np.argmax(statistic))
    if statistic[best_index] < _NOISE_T or difference[best_index] < np.log(_NOISE_RATIO) / 2:
        return []
    cut = start + int(cuts[best_index])
    return [*_split(log, start, cut), cut, *_split(log, cut, end)]


def noise_report(
    block: FrameBlock,
    use: Mask,
    steps: tuple[NoiseStep, ...],
    busy_s: tuple[tuple[float, float], ...],
    *,
    timed: bool,
) -> NoiseReport:
    """Report the noise of the longest stretch without a step or a load.

    Parameters
    ----------
    use : (drives, measures) bool, readings to judge by.
    busy_s : start and end of each load [s].
    timed : whether the times are meaningful; otherwise no drift is given.
    """
    readings = block.voltages[:, use]
    unit = block.unit.value
    quiet_slice = _find_quietest_stretch(block.time_s, readings, steps, busy_s)
    if quiet_slice is None or quiet_slice.stop - quiet_slice.start < _MIN_QUIET_FRAMES or not readings.size:
        return NoiseReport(None, unit, None, steps, None, 0)
    quiet_readings, times = readings[quiet_slice], block.time_s[quiet_slice]
    sigma = channel_noise(quiet_readings, counts=block.unit is VoltageUnit.COUNT)
    drift = _drift_per_min(times, quiet_readings) if timed else None
    rounding = 1 if unit == "count" else 0
    is_outlier = (
        np.abs(quiet_readings - np.median(quiet_readings, axis=0))
        > _OUTLIER * np.maximum(sigma, rounding) + rounding / 2
    )
    return NoiseReport(
        rms=float(np.median(sigma)),
        unit=unit,
        drift_per_min=drift,
        steps=steps,
        quiet_s=(float(times[0]), float(times[-1])),
        frames=len(times),
        outliers=float(np.mean(is_outlier)),
    )


def _drift_per_min(times: Array, readings: Array) -> float | None:
    """Median over channels of the slope between the means of the first and the last third [unit/min]."""
    third = len(times) // 3
    span = float(times[-third:].mean() - times[:third].mean()) if third else 0.0
    if span <= 0:
        return None
    change = np.median(readings[-third:], axis=0) - np.median(readings[:third], axis=0)
    return float(np.median(change)) / span * 60


def _find_quietest_stretch(
    time_s: Array, readings: Array, steps: tuple[NoiseStep, ...], busy_s: tuple[tuple[float, float], ...]
) -> slice | None:
    group = np.searchsorted(np.array([step.time_s for step in steps]), time_s, side="right")
    quiet_mask = np.ones(len(time_s), dtype=bool)
    for start, end in busy_s:
        quiet_mask &= (time_s < start) | (time_s > end)
        group = group + (time_s > end)
    stretches = [np.flatnonzero(quiet_mask & (group == label)) for label in np.unique(group[quiet_mask])]
    if not stretches:
        return None
    longest = max(len(members) for members in stretches)
    # Among stretches about as long, the quietest shows what the instrument can do.
    alike = [members for members in stretches if len(members) >= _MIN_STRETCH_SHARE * longest]
    best = alike[0]
    if len(alike) > 1:
        spreads = [
            float(np.median(channel_noise(readings[members], counts=False))) if len(members) > 1 else np.inf
            for members in alike
        ]
        best = alike[spreads.index(min(spreads))]
    return slice(int(best[0]), int(best[-1]) + 1)
