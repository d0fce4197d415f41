"""Loops: readings and force while a press steps down and up through its strains."""

from collections import defaultdict
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.defects.load_cell import describe_cell_limit
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock
from cbsr_qa.domain.readings.loads import HeldStrain, Indenter, LoadRecord
from cbsr_qa.domain.results.observation import LoopObservation, Trace
from cbsr_qa.domain.run.run import PhaseRecord, RunRecord

#: Number of its own standard errors that the output at the deepest strain must be away from zero.
_CLEAR: Final = 5.0
_SILENT: Final = "no load stands out of the noise"
_FRAMELESS: Final = "no frame was taken before the loop, or while a strain was held"
#: Huber's constant, 95 % efficient for normal errors, and the median of their absolute values.
_HUBER, _NORMAL_MEDIAN = 1.345, 0.6745
_ROUNDS: Final = 8


def observe_loops(
    record: RunRecord, unloaded: FrameBlock, usable: NDArray[np.bool_], settings: AnalysisSettings
) -> tuple[LoopObservation, ...]:
    """Analyse the loops of a run, by phase and place.

    The output of a frame is the amplitude of its readings, each over its noise, along one pattern: their response to
    strain in all loops of the place. A blob's mean, used for single presses, is twice as noisy.

    Parameters
    ----------
    record : record of the run, without lost frames.
    unloaded : frames of the rested sheet, for the noise of each reading.
    usable : (drives, measures) bool, readings to use.
    """
    loops_of_places = []
    for phase in record.phases:
        places: dict[tuple[str, float, float], list[LoadRecord]] = defaultdict(list)
        for loop in phase.loops:
            places[(loop.load.label, loop.load.x_mm, loop.load.y_mm)].append(loop)
        for loops in places.values():
            loops_of_places.append(_observe_loops(phase, tuple(loops), unloaded, usable, record.indenter, settings))
    return tuple(loops_of_places)


def deepest(record: LoadRecord) -> HeldStrain:
    """Return the deepest strain of a press, with the time it was held."""
    return max(record.held, key=lambda held: held.strain)


def deepest_hold(record: LoadRecord) -> LoadRecord:
    """Return a loop as if only its deepest strain had been held."""
    hold = deepest(record)
    load = replace(record.load, strain=hold.strain)
    return replace(record, load=load, hold_start_s=hold.start_s, release_start_s=hold.end_s, eased=())


def _observe_loops(
    phase: PhaseRecord,
    loops: tuple[LoadRecord, ...],
    unloaded: FrameBlock,
    usable: NDArray[np.bool_],
    indenter: Indenter,
    settings: AnalysisSettings,
) -> LoopObservation:
    samples = phase.channel("force")
    # Of the strains that were held, the first at which the cell was at its limit.
    holds = [replace(loop, hold_start_s=h.start_s, release_start_s=h.end_s) for loop in loops for h in loop.held]
    no_force = next((reason for hold in holds if (reason := describe_cell_limit(samples, hold))), "")
    stress = None if no_force else _stress(samples, loops, indenter)
    first_s, last_s = loops[0].press_start_s, loops[-1].rest_end_s
    if phase.frames is None:
        return _make_empty_loop(phase, loops, stress, no_force, _FRAMELESS)
    frames_before = _frames_before(phase, phase.frames, first_s, settings.reference_frames)
    frames_during = phase.frames.select_interval(first_s, last_s)
    if not len(frames_before) or not all(
        len(frames_during.select_interval(h.start_s, h.end_s)) for cycle in loops for h in cycle.held
    ):
        return _make_empty_loop(phase, loops, stress, no_force, _FRAMELESS)
    noise = unloaded.voltages[:, usable].std(axis=0, ddof=1)
    scale = 1 / np.sqrt(noise**2 + np.mean(noise**2)) if noise.any() else np.ones(len(noise))
    rows = (frames_during.voltages[:, usable] - frames_before.voltages[:, usable].mean(axis=0)) * scale
    pattern = _pattern(rows, frames_during.time_s, loops)
    if not pattern.any():
        return _make_empty_loop(phase, loops, stress, no_force, _SILENT)
    output = _amplitudes(rows, pattern)
    deepest_mask = np.zeros(len(output), dtype=np.bool_)
    for loop in loops:
        hold = deepest(loop)
        deepest_mask |= (frames_during.time_s >= hold.start_s) & (frames_during.time_s < hold.end_s)
    span, spread = (
        float(output[deepest_mask].mean()),
        float(np.linalg.norm(noise * scale * pattern) / (pattern @ pattern)),
    )
    reason = "" if span > _CLEAR * spread / np.sqrt(deepest_mask.sum()) else _SILENT
    unit = span if span > 0 else 1.0
    trace = Trace("output", "1", frames_during.time_s, output / unit)
    return LoopObservation(phase.name, loops, trace, spread / unit, stress, no_force, reason)


def _make_empty_loop(
    phase: PhaseRecord, loops: tuple[LoadRecord, ...], stress: Trace | None, no_force: str, why: str
) -> LoopObservation:
    empty = Trace("output", "1", np.zeros(0), np.zeros(0))
    return LoopObservation(phase.name, loops, empty, 0.0, stress, no_force, why)


def _frames_before(phase: PhaseRecord, frames: FrameBlock, press_s: float, count: int) -> FrameBlock:
    """Frames before the first press: all since the sheet was marked rested, or the last few after other presses."""
    rested = phase.unloaded_from_s
    earlier_loads = [load for load in (*phase.loads, *phase.loops) if load.press_start_s < press_s]
    if rested is not None and not any(rested <= load.press_start_s for load in earlier_loads):
        return frames.select_interval(rested, press_s)
    frames = frames.select_interval(
        max((load.release_end_s for load in earlier_loads), default=phase.started_s), press_s
    )
    return frames.select(slice(max(len(frames) - count, 0), None))


def _pattern(rows: Array, time_s: Array, loops: tuple[LoadRecord, ...]) -> Array:
    """Response of each reading to strain, (readings,): slope over the medians of holds and rest ends.

    A linear drift is fitted too, and outlying holds get little weight (Huber), so that drift or dropout of an
    electrode is not taken for a response.
    """
    windows = [(hold.strain, hold.start_s, hold.end_s) for loop in loops for hold in loop.held]
    windows += [(0.0, (loop.unloaded_s + loop.rest_end_s) / 2, loop.rest_end_s) for loop in loops]
    medians, strains, times = [], [0.0], [float(time_s[0])]
    for strain, from_s, to_s in windows:
        inside_mask = (time_s >= from_s) & (time_s < to_s)
        if inside_mask.any():
            medians.append(np.median(rows[inside_mask], axis=0))
            strains.append(strain)
            times.append((from_s + to_s) / 2)
    values = np.vstack([np.zeros(rows.shape[1]), *medians])  # zero, just before the first press
    since = (np.array(times) - times[0]) / max(float(np.ptp(times)), 1.0)
    design = np.column_stack([np.array(strains) / max(strains), since, np.ones_like(since)])
    weights = np.ones_like(values)
    for _ in range(_ROUNDS):
        normal = np.einsum("hi,hr,hj->rij", design, weights, design)
        drawn = np.einsum("hi,hr,hr->ri", design, weights, values)
        fit = np.linalg.solve(normal + 1e-12 * np.eye(3), drawn[:, :, None])[:, :, 0]
        weights = _huber(values - design @ fit.T, axis=0)
    return fit[:, 0]


def _amplitudes(rows: Array, pattern: Array) -> Array:
    """Amplitude (n,) of each row along a pattern; outlying readings get little weight (Huber)."""
    weights = np.ones_like(rows)
    for _ in range(_ROUNDS):
        along = (weights * rows) @ pattern / (weights @ pattern**2)
        weights = _huber(rows - along[:, None] * pattern, axis=1)
    return along


def _huber(residual: Array, *, axis: int) -> Array:
    """Huber weights of residuals, relative to their median size along an axis: 1, but less for outliers."""
    size = np.median(np.abs(residual), axis=axis, keepdims=True) / _NORMAL_MEDIAN
    reach = _HUBER * np.maximum(size, np.finfo(np.float64).tiny)
    return np.minimum(1.0, reach / np.maximum(np.abs(residual), np.finfo(np.float64).tiny))


def _stress(samples: SampleBlock | None, loops: tuple[LoadRecord, ...], indenter: Indenter) -> Trace | None:
    if samples is None:
        return None
    samples_of_loops = samples.select_interval(loops[0].press_start_s, loops[-1].rest_end_s)
    if not len(samples_of_loops):
        return None
    return Trace("stress", "kPa", samples_of_loops.time_s, samples_of_loops.values / indenter.area_mm2 * 1e3)
