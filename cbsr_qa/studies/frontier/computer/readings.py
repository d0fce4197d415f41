"""Places and sizes of nine loads in images, from simulated noisy readings of the base scene."""

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Final

import numpy as np

from cbsr_qa.config.loader import load_material, load_scene_plan, load_sensor_type
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.geometry.footprints import Footprint
from cbsr_qa.domain.imaging import Image, PreparedReconstruction
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.imaging.blobs import nearest_blob, noise_floor, subtract_noise_floor
from cbsr_qa.eit.imaging.contours import contour_regions
from cbsr_qa.eit.imaging.shape import SpatialFigures, spatial_figures
from cbsr_qa.eit.inverse.scaling import changes, scale_of
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.simulate.recording import press_loads
from cbsr_qa.simulate.sheet import SimulatedSheet
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.studies.frontier.point import Accuracy, Better

NOISE_FRAMES: Final = 8  # as in the recipes: frames of the noise floor
REFERENCE_FRAMES: Final = 4
STEADY_FRAMES: Final = 4

_SCENE: Final = "base"
_HOLD_S: Final = 120.0  # longer than the material needs to settle
_APART_S: Final = 600.0  # long enough for the residue of each load to vanish
_FIRST_S: Final = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedReadings:
    """Readings of simulated sensors, each with its own seed.

    Parameters
    ----------
    unloaded : (seeds, frames, drives, measures) [V], of the rested sheet: for the noise floor, then for the
        reference.
    loaded : (seeds, n, drives, measures) [V] under n heads, each the mean of the last frames of a hold.
    """

    sensor_type: SensorType
    heads: tuple[Footprint, ...]
    unloaded: Array
    loaded: Array


@lru_cache(maxsize=4)
def base_scene_readings(seeds: int) -> SimulatedReadings:
    """Simulate the shipped base scene's nine loads of 20 % strain, with seeds from 1 on; once per process.

    Loads are so far apart in time that no residue remains; otherwise the scene is unchanged.

    ConfigError if there are no seeds.
    """
    if seeds < 1:
        raise ConfigError(f"{seeds} seeds, and no sensor to simulate", remedy="simulate at least one sensor")
    plan = load_scene_plan(_SCENE).value
    loads = (
        replace(load, start_s=_FIRST_S + number * _APART_S, hold_s=_HOLD_S) for number, load in enumerate(plan.loads)
    )
    end_s = _FIRST_S + len(plan.loads) * _APART_S
    plan = replace(plan, loads=tuple(loads), duration_s=end_s)
    sensor_type, material = load_sensor_type(str(plan.sensor_type)).value, load_material(str(plan.material)).value
    factory = partial(discover().factory, Kind.EFFECT)
    sheet: SimulatedSheet | None = None
    unloaded, loaded = [], []
    for seed in range(1, seeds + 1):
        world = SimulatedWorld(
            plan.scene, sensor_type, material, plan.indenter, seed=seed, effect_factory=factory, sheet=sheet
        )
        sheet = world.sheet  # the base scene's is the same for each seed
        unloaded.append(_frames(world, 0, NOISE_FRAMES + REFERENCE_FRAMES))
        steady = []
        for pressed in press_loads(world, plan, end_s):
            last = int(pressed.record.release_start_s / world.setting.frame_period_s)
            steady.append(_frames(world, last - STEADY_FRAMES, last).mean(axis=0))
        loaded.append(steady)
    heads = tuple(plan.indenter.footprint_at(*load.place_mm) for load in plan.loads)
    return SimulatedReadings(sensor_type, heads, np.array(unloaded), np.array(loaded))


def _frames(world: SimulatedWorld, first: int, end: int) -> Array:
    """Readings (k, drives, measures) of consecutive frames [V]."""
    period_s = world.setting.frame_period_s
    return np.array([world.voltages_V((index + 0.5) * period_s, index) for index in range(first, end)])


_MASK: Final = 0.85  # the recipes' main mask
_ROUNDING: Final = 1e-9  # smaller values are not signal, however quiet the unloaded frames
#: Figures of merit: attribute, unit, and direction of improvement.
_FIGURES: Final[dict[str, tuple[str, str, Better]]] = {
    "E_CoM": ("error_mm", "mm", "less"),
    "A_OL": ("overlap_percent", "%", "more"),
    "SD": ("deviation_mm2", "mm²", "less"),
}


def figures_of_merit(prepared: PreparedReconstruction, readings: SimulatedReadings) -> dict[str, Accuracy]:
    """Return mean E_CoM, A_OL and SD over the nine places with standard errors, and the share of loads missed.

    The steps are those of a run with a shipped recipe: changes against the mean of the reference frames, the noise
    floor of the unloaded images subtracted, the 85 % mask bounded by a contour, the region nearest to the head.
    """
    sensors = [_sensor(prepared, readings, number) for number in range(len(readings.loaded))]
    figures_by_sensor = [[figures for figures in sensor if figures is not None] for sensor in sensors]
    missed = [1 - len(sensor_figures) / len(readings.heads) for sensor_figures in figures_by_sensor]
    figures = {"missed": Accuracy.from_sensors(missed, "1")}
    for name, (attribute, unit, better) in _FIGURES.items():
        means = [
            np.mean([getattr(load_figures, attribute) for load_figures in sensor_figures])
            for sensor_figures in figures_by_sensor
            if sensor_figures
        ]
        if means:
            mean = Accuracy.from_sensors(means, unit, better)
            figures[name] = mean if len(means) == len(sensors) else replace(mean, by_sensor=())  # no pairs of sensors
    return figures


def sensor_changes(readings: SimulatedReadings, number: int, prepared: PreparedReconstruction) -> tuple[Array, Array]:
    """Scaled changes of one sensor's unloaded frames (k, m) and of its loads (n, m)."""
    problem = prepared.problem
    reference = readings.unloaded[number, NOISE_FRAMES:].mean(axis=0)
    scale = scale_of(reference, problem)
    quiet, loaded = readings.unloaded[number, :NOISE_FRAMES], readings.loaded[number]
    return changes(quiet, reference, problem, scale), changes(loaded, reference, problem, scale)


def _sensor(
    prepared: PreparedReconstruction, readings: SimulatedReadings, number: int
) -> list[SpatialFigures | None]:
    """Figures of each load of one sensor; None without a region."""
    quiet, loaded = sensor_changes(readings, number, prepared)
    floor = max(noise_floor(prepared.images(quiet)), _ROUNDING)
    figures: list[SpatialFigures | None] = []
    for change, head in zip(loaded, readings.heads, strict=True):
        (image,) = prepared.images(change[None])  # one frame at a time, as on a rig: independent of its neighbours
        regions = contour_regions(Image(prepared.problem.mesh, subtract_noise_floor(image, floor)), _MASK)
        figures += spatial_figures([nearest_blob(regions, *head.centre_mm)], head)
    return figures
