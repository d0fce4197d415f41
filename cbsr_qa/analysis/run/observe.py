"""Observations from a stored run: reference, noise floor, response, every press, metrics of every frame."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cbsr_qa.analysis.defects.load_cell import describe_zero_shift
from cbsr_qa.analysis.run.imaging import Imager, decide_response, find_sensed_regions
from cbsr_qa.analysis.run.loads import (
    LoadSetting,
    LoadWindow,
    add_relaxations,
    list_neighbours,
    load_window,
    mean_change_under_head,
    observe_load,
    relaxations_of,
)
from cbsr_qa.analysis.run.loops import deepest_hold, observe_loops
from cbsr_qa.analysis.run.reference import (
    check_weighing,
    drop_weak_polarity,
    find_unloaded_frames,
    linearise_sheet,
    split_unloaded,
    usable_data,
)
from cbsr_qa.domain.geometry.footprints import Footprint
from cbsr_qa.domain.imaging import linear
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.results.observation import LoadObservation, MetricTimeline, RunObservation
from cbsr_qa.domain.run.run import PhaseRecord, RunRecord
from cbsr_qa.domain.sensor.sensor_type import Response
from cbsr_qa.eit.imaging.blobs import noise_floor
from cbsr_qa.eit.imaging.shape import spatial_figures
from cbsr_qa.eit.inverse.scaling import scale_doubts, scale_of
from cbsr_qa.eit.inverse.uncertainty import masking_effect
from cbsr_qa.plugin.interfaces import Reconstruction


def metric_timelines(setting: LoadSetting, record: RunRecord) -> tuple[MetricTimeline, ...]:
    """Metrics over time of the phases that press a grid of places; of the last of several simultaneous loads."""
    return tuple(
        _timeline(setting, phase)
        for phase in record.phases
        if phase.role is Role.GRID and phase.frames is not None and phase.loads
    )


def _timeline(setting: LoadSetting, phase: PhaseRecord) -> MetricTimeline:
    assert phase.frames is not None
    masks, time_s = setting.settings.masks, phase.frames.time_s
    metrics = np.full((3, len(masks), len(phase.frames)), np.nan)
    images = setting.response.sign * setting.imager.images(phase.frames)
    for record in phase.loads:
        held_mask = (time_s >= record.hold_start_s) & (time_s < record.release_start_s)
        for frame in np.flatnonzero(held_mask):
            neighbours = list_neighbours(setting.indenter, phase, record, float(time_s[frame]))
            metrics[:, :, frame] = _metrics(setting, images[frame], record, neighbours)
    return MetricTimeline(phase.name, time_s, masks, metrics[0], metrics[1], metrics[2], phase.channel("force"))


def _metrics(setting: LoadSetting, signed: Array, record: LoadRecord, others: list[Footprint]) -> Array:
    """Three metrics of every mask, (3, k); NaN where no blob is seen."""
    settings, footprint = setting.settings, setting.indenter.footprint_at(record.load.x_mm, record.load.y_mm)
    regions = find_sensed_regions(setting.imager.mesh, signed, setting.noise_floor, settings, footprint, others)
    metrics = spatial_figures(regions, footprint, clipping=settings.clipping, perimeter=settings.perimeter)
    nothing = (np.nan, np.nan, np.nan)
    return np.array([nothing if f is None else (f.error_mm, f.overlap_percent, f.deviation_mm2) for f in metrics]).T


def observe_run(
    record: RunRecord, reconstruction: Reconstruction, settings: AnalysisSettings, *, over_time: bool = True
) -> RunObservation:
    """Compute everything about a run that metrics need.

    Parameters
    ----------
    record : the run as stored, the only input.
    over_time : whether to compute relaxations and metrics of every frame too, which take most of the time and which
        force does not need. Without them it is unknown whether holds had settled.

    Raises
    ------
    NumericsError
        If the run has no unloaded frames, too few usable readings, or a load without a frame; or if the recipe
        weights readings by their noise, which cannot be estimated.
    """
    data = usable_data(record)
    unloaded = find_unloaded_frames(data.record)
    for_noise, for_reference = split_unloaded(unloaded, settings.noise_floor_frames)
    check_weighing(reconstruction, type(reconstruction).__name__, settings)
    problem, silent_remarks = linearise_sheet(data, unloaded, settings)
    answering = drop_weak_polarity(data, unloaded, problem.reference)
    if answering is not data:
        data = answering
        problem, silent_remarks = linearise_sheet(data, unloaded, settings)
    reference = for_reference.voltages.mean(axis=0)
    imager = Imager(linear(reconstruction.prepare(problem)), reference, scale_of(reference, problem))
    noise_images = imager.images(for_noise)
    floor = noise_floor(noise_images)
    phases = data.record.phases
    cut = [(phase, load, load_window(phase, load, settings)) for phase in phases for load in phase.loads]
    # Loops give the sign of the conductance change only without ordinary presses.
    looped = [(phase, deepest_hold(loop)) for phase in phases for loop in phase.loops]
    voting = cut or [(phase, load, load_window(phase, load, settings)) for phase, load in looped]
    undecided = LoadSetting(imager, settings, record.indenter, floor, Response.AUTO)
    signals = [mean_change_under_head(undecided, load, window) for _, load, window in voting]
    response, response_how, doubts = decide_response(record.sensor_type.response, signals, floor)
    setting = replace(undecided, response=response)
    loads = tuple(observe_load(setting, phase, load, window) for phase, load, window in cut)
    timelines: tuple[MetricTimeline, ...] = ()
    if over_time:
        loads, timelines = _add_time_courses(setting, data.record, cut, loads)
    observation = RunObservation(
        record=data.corrected,
        reconstruction=imager.reconstruction,
        scale=imager.scale,
        unloaded=unloaded,
        reference=imager.reference,
        noise_floor=floor,
        noise_images=noise_images,
        response=response,
        response_how=response_how,
        main_mask=settings.main_mask,
        loads=loads,
        usable=data.readings,
        settings=settings,
        loops=observe_loops(data.record, unloaded, data.readings, settings),
        timelines=timelines,
    )
    remarks = _remarks(observation.tested, settings.settling_multiple if over_time else None)
    odd = scale_doubts(imager.reference, problem)
    effect = masking_effect(problem)
    lost = () if effect is None else (effect.words(),)
    zeros = filter(None, [describe_zero_shift(phase.channel("force"), phase.loads) for phase in phases])
    return replace(observation, warnings=(*data.warnings, *zeros, *lost, *odd, *silent_remarks, *doubts, *remarks))


def _add_time_courses(
    setting: LoadSetting,
    record: RunRecord,
    cut: Sequence[tuple[PhaseRecord, LoadRecord, LoadWindow]],
    loads: tuple[LoadObservation, ...],
) -> tuple[tuple[LoadObservation, ...], tuple[MetricTimeline, ...]]:
    """Return loads with their relaxations, and the metrics of every frame."""
    timelines = metric_timelines(setting, record)
    relaxed = [
        add_relaxations(load, window, relaxations_of(setting, phase, load, window), setting.settings)
        for load, (phase, _, window) in zip(loads, cut, strict=True)
    ]
    return tuple(relaxed), timelines


def _remarks(loads: tuple[LoadObservation, ...], multiple: float | None) -> tuple[str, ...]:
    """Warnings about loads; about settling only if the recipe gives a multiple of the settling time."""
    remarks = []
    residual = [load for load in loads if load.alternate is not None]
    if residual:
        worst = max(residual, key=lambda load: load.residue)
        remarks.append(
            f"before {len(residual)} of {len(loads)} presses the image still showed earlier loads above the noise"
            f" floor, most clearly before {worst.record.load.label} (phase {worst.phase!r}):"
            " both references are reported there"
        )
    if multiple is None:
        return tuple(remarks)
    n_early = sum(load.settled is False for load in loads)
    if n_early:
        remarks.append(
            f"in {n_early} of {len(loads)} holds the last frames were taken before {multiple:g} settling times had"
            " passed: their images show a sheet that is still relaxing"
        )
    unknown = sum(load.settled is None for load in loads)
    if unknown:
        remarks.append(
            f"for {unknown} of {len(loads)} holds no settling time is known (no blob, or no fit): their last frames"
            " may not be settled"
        )
    return tuple(remarks)
