"""Simulated noisy readings of the base scene at the nine places: what images are judged on."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.config.loader import load_material, load_scene_plan, load_sensor_type
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.footprints import Footprint
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.hookspecs import Kind
from cbsr_qa.plugins import Plugins, discover
from cbsr_qa.simulate.scene_heads import PressedLoad, press_loads
from cbsr_qa.simulate.sheet import SimulatedSheet
from cbsr_qa.simulate.world import SimulatedWorld

Array = NDArray[np.float64]

NOISE_FRAMES: Final = 8  # as the recipes: the noise floor is of these
REFERENCE_FRAMES: Final = 4
STEADY_FRAMES: Final = 4

_SCENE: Final = "base"
_HOLD_S: Final = 120.0  # longer than the material needs to settle
_APART_S: Final = 600.0  # of each load nothing is left when the next one comes
_FIRST_S: Final = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedReadings:
    """Readings of one simulated sensor after the other, each with its own seed.

    Parameters
    ----------
    sensor_type : that was simulated.
    heads : where its indenter pressed, n places.
    unloaded : (seeds, frames, drives, measures) [V], of the rested sheet: those of the noise floor, then those of
        the reference.
    loaded : (seeds, n, drives, measures) [V], each the mean of the last frames of a hold.
    """

    sensor_type: SensorType
    heads: tuple[Footprint, ...]
    unloaded: Array
    loaded: Array


@lru_cache(maxsize=4)
def base_scene_readings(seeds: int) -> SimulatedReadings:
    """Simulate the shipped base scene's nine loads of 20 % strain, with seeds from 1 on; once per process.

    The scene's loads press one at a time with so long a rest between them that nothing of the one before is left;
    everything else is as in the scene: its sheet, material, noise and error of the sheet's seat.

    Raises
    ------
    ConfigError
        If there is no seed.
    """
    if seeds < 1:
        raise ConfigError(f"{seeds} seeds are none", remedy="simulate at least one sensor")
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
        loaded.append([_steady(world, one) for one in pressed])
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
    """Mean of the last whole frames of a hold."""
    last = int(pressed.record.release_start_s / world.setting.frame_period_s)
    frames = np.array([_frame(world, index) for index in range(last - STEADY_FRAMES, last)])
    mean: Array = frames.mean(axis=0)
    return mean
