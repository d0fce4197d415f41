"""Spatial metrics of every frame of a phase, for every mask: how they come and go with the load."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.run_loads import LoadSetting
from cbsr_qa.analysis.run_masks import mask_views
from cbsr_qa.domain.image import Blob
from cbsr_qa.domain.loads import LoadRecord
from cbsr_qa.domain.observation import MetricTimeline
from cbsr_qa.domain.run import PhaseRecord, RunRecord
from cbsr_qa.domain.steps import Role
from cbsr_qa.imaging.shape import area_overlap_percent, centre_of_mass_error_mm, shape_deviation_mm2


def metric_timelines(setting: LoadSetting, record: RunRecord) -> tuple[MetricTimeline, ...]:
    """Metrics over time of the phases that press a grid of places."""
    return tuple(
        _timeline(setting, phase)
        for phase in record.phases
        if phase.role is Role.GRID and phase.frames is not None and phase.loads
    )


def _timeline(setting: LoadSetting, phase: PhaseRecord) -> MetricTimeline:
    assert phase.frames is not None
    masks = setting.settings.masks
    metrics = np.full((3, len(masks), len(phase.frames)), np.nan)
    images = setting.sign * setting.imager.images(phase.frames)
    for record in phase.loads:
        held = (phase.frames.time_s >= record.hold_start_s) & (phase.frames.time_s < record.release_start_s)
        for frame in np.flatnonzero(held):
            metrics[:, :, frame] = _metrics(setting, images[frame], record)
    return MetricTimeline(
        phase.name, phase.frames.time_s, masks, metrics[0], metrics[1], metrics[2], phase.channel("force")
    )


def _metrics(setting: LoadSetting, signed: NDArray[np.float64], record: LoadRecord) -> NDArray[np.float64]:
    views = mask_views(setting.imager.mesh, signed, setting.noise_floor, setting.settings, record.load)
    columns = [_of_blob(setting, view.sensed, record) for view in views]
    return np.array(columns).T


def _of_blob(setting: LoadSetting, blob: Blob | None, record: LoadRecord) -> tuple[float, float, float]:
    if blob is None:
        return (np.nan, np.nan, np.nan)
    pressed, chosen = setting.indenter.at(record.load.x_mm, record.load.y_mm), setting.settings
    return (
        centre_of_mass_error_mm(blob, pressed),
        area_overlap_percent(blob, pressed, chosen.clipping),
        shape_deviation_mm2(blob, pressed, chosen.perimeter),
    )
