"""Places and sizes of nine loads in images, from simulated noisy readings of the base scene."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, Literal

import numpy as np

from cbsr_qa.config import load_material, load_scene_plan, load_sensor_type
from cbsr_qa.domain import Array, ConfigError
from cbsr_qa.domain.geometry import Footprint
from cbsr_qa.domain.results import Image, PreparedReconstruction
from cbsr_qa.domain.sensor import Mesh, SensorType
from cbsr_qa.eit.imaging import contour_regions, floored, nearest_blob, noise_floor, spatial_figures
from cbsr_qa.eit.inverse import changes, scale_of
from cbsr_qa.plugin import Kind, Plugins, discover
from cbsr_qa.simulate import PressedLoad, SimulatedSheet, SimulatedWorld, press_loads
from cbsr_qa.studies.frontier.point import Accuracy

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
    sensor_type = load_sensor_type(str(plan.sensor_type)).value
    heads = tuple(plan.indenter.at(*load.place_mm) for load in plan.loads)
    plugins, unloaded, loaded = discover(), [], []
    sheet: SimulatedSheet | None = None
    for seed in range(1, seeds + 1):
        world = _world(plugins, sensor_type, seed, sheet)
        sheet = world.sheet  # the base scene's is the same for each seed
        loads = tuple(
            replace(load, start_s=_FIRST_S + number * _APART_S, hold_s=_HOLD_S)
            for number, load in enumerate(plan.loads)
        )
        end_s = _FIRST_S + len(loads) * _APART_S
        pressed = press_loads(world, replace(plan, loads=loads, duration_s=end_s), end_s)
        unloaded.append([_frame(world, index) for index in range(NOISE_FRAMES + REFERENCE_FRAMES)])
        loaded.append([_steady(world, load) for load in pressed])
    return SimulatedReadings(sensor_type, heads, np.array(unloaded), np.array(loaded))


def _world(plugins: Plugins, sensor_type: SensorType, seed: int, sheet: SimulatedSheet | None) -> SimulatedWorld:
    plan = load_scene_plan(_SCENE).value

    def effect(name: str) -> Any:
        return plugins.factory(Kind.EFFECT, name)

    return SimulatedWorld(
        plan.scene,
        sensor_type,
        load_material(str(plan.material)).value,
        plan.indenter,
        seed=seed,
        effect_factory=effect,
        sheet=sheet,
    )


def _frame(world: SimulatedWorld, index: int) -> Array:
    return world.voltages_V((index + 0.5) * world.setting.frame_period_s, index)


def _steady(world: SimulatedWorld, pressed: PressedLoad) -> Array:
    last = int(pressed.record.release_start_s / world.setting.frame_period_s)
    frames = np.array([_frame(world, index) for index in range(last - STEADY_FRAMES, last)])
    mean: Array = frames.mean(axis=0)
    return mean


_MASK: Final = 0.85  # the recipes' main mask
_ROUNDING: Final = 1e-9  # smaller values are not signal, however quiet the unloaded frames
#: Figures of merit: unit, and direction of improvement.
_FIGURES: Final[dict[str, tuple[str, Literal["more", "less"]]]] = {
    "E_CoM": ("mm", "less"),
    "A_OL": ("%", "more"),
    "SD": ("mm²", "less"),
}


def figures_of_merit(prepared: PreparedReconstruction, readings: SimulatedReadings) -> dict[str, Accuracy]:
    """Return mean E_CoM, A_OL and SD over the nine places with standard errors, and the share of loads missed.

    As a run of the shipped recipes does: changes against the mean of the reference frames, the noise floor of the
    unloaded images subtracted, the 85 % mask bounded by a contour, the region nearest to the head.
    """
    seen = np.array([_sensor(prepared, readings, number) for number in range(len(readings.loaded))])
    figures = {"missed": _mean(np.isnan(seen[:, :, 0]).mean(axis=1), "1")}
    known = seen[~np.isnan(seen[:, :, 0]).all(axis=1)]
    for column, (name, (unit, better)) in enumerate(_FIGURES.items()):
        if len(known):
            figures[name] = _mean(np.nanmean(known[:, :, column], axis=1), unit, better)
    return figures


def sensor_changes(readings: SimulatedReadings, number: int, prepared: PreparedReconstruction) -> tuple[Array, Array]:
    """Scaled changes of one sensor's unloaded frames (k, m) and of its loads (n, m)."""
    problem = prepared.problem
    reference = readings.unloaded[number, NOISE_FRAMES:].mean(axis=0)
    scale = scale_of(reference, problem)
    quiet, loaded = readings.unloaded[number, :NOISE_FRAMES], readings.loaded[number]
    return changes(quiet, reference, problem, scale), changes(loaded, reference, problem, scale)


def _sensor(prepared: PreparedReconstruction, readings: SimulatedReadings, number: int) -> list[Array]:
    """Figures of each load of one sensor, (n, 3); NaN without a blob."""
    quiet, loaded = sensor_changes(readings, number, prepared)
    floor = max(noise_floor(prepared.images(quiet)), _ROUNDING)
    # One frame at a time, as on a rig: an image must not depend on its neighbours.
    return [
        _load(prepared.images(change[None])[0], prepared.problem.mesh, head, floor)
        for change, head in zip(loaded, readings.heads, strict=True)
    ]


def _load(image: Array, mesh: Mesh, head: Footprint, floor: float) -> Array:
    regions = contour_regions(Image(mesh, floored(image, floor)), _MASK)
    (figures,) = spatial_figures([nearest_blob(regions, *head.centre_mm)], head)
    if figures is None:
        return np.full(len(_FIGURES), np.nan)
    return np.array([figures.error_mm, figures.overlap_percent, figures.deviation_mm2])


def _mean(values: Array, unit: str, better: Literal["more", "less"] = "less") -> Accuracy:
    """Mean over sensors with its standard error, which needs at least two."""
    count = len(values)
    stderr = float(values.std(ddof=1) / np.sqrt(count)) if count > 1 else None
    return Accuracy(float(values.mean()), stderr, unit, better)
