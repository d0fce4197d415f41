"""Spatial metrics of every frame of a phase, for every mask: how they come and go with the load."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.run_loads import LoadSetting, held_beside
from cbsr_qa.analysis.run_masks import sensed_regions
from cbsr_qa.domain.footprints import Footprint
from cbsr_qa.domain.loads import LoadRecord
from cbsr_qa.domain.observation import MetricTimeline
from cbsr_qa.domain.run import PhaseRecord, RunRecord
from cbsr_qa.domain.steps import Role
from cbsr_qa.imaging.shape import spatial_figures


def metric_timelines(setting: LoadSetting, record: RunRecord) -> tuple[MetricTimeline, ...]:
    """Metrics over time of the phases that press a grid of places; of the last of several loads held at once."""
    return tuple(
        _timeline(setting, phase)
        for phase in record.phases
        if phase.role is Role.GRID and phase.frames is not None and phase.loads
    )


def _timeline(setting: LoadSetting, phase: PhaseRecord) -> MetricTimeline:
    assert phase.frames is not None
    masks, time_s = setting.settings.masks, phase.frames.time_s
    metrics = np.full((3, len(masks), len(phase.frames)), np.nan)
    images = setting.sign * setting.imager.images(phase.frames)
    for record in phase.loads:
        held = (time_s >= record.hold_start_s) & (time_s < record.release_start_s)
        for frame in np.flatnonzero(held):
            others = held_beside(setting.indenter, phase, record, float(time_s[frame]))
            metrics[:, :, frame] = _metrics(setting, images[frame], record, others)
    return MetricTimeline(phase.name, time_s, masks, metrics[0], metrics[1], metrics[2], phase.channel("force"))


def _metrics(
    setting: LoadSetting, signed: NDArray[np.float64], record: LoadRecord, others: list[Footprint]
) -> NDArray[np.float64]:
    """Three metrics of every mask, (3, k); NaN where no blob is seen."""
    chosen, pressed = setting.settings, setting.indenter.at(record.load.x_mm, record.load.y_mm)
    regions = sensed_regions(setting.imager.mesh, signed, setting.noise_floor, chosen, pressed, others)
    found = spatial_figures(regions, pressed, clipping=chosen.clipping, perimeter=chosen.perimeter)
    nothing = (np.nan, np.nan, np.nan)
    return np.array([nothing if f is None else (f.error_mm, f.overlap_percent, f.deviation_mm2) for f in found]).T
