"""Simulated worlds to draw: the shipped sensor on a coarse mesh, with the effects that a figure is about."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.config.loader import load_material, load_scene, load_sensor_type
from cbsr_qa.domain.plan.plan import PluginChoice, Scene
from cbsr_qa.domain.plan.world import SimulatedPress, StrainRamp
from cbsr_qa.domain.sensor.sensor_type import Material
from cbsr_qa.plugin import (
    Indenter,
    Kind,
    Motion,
    SceneSetting,
    SensorType,
    SheetDesign,
    StationContext,
)
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.simulate.chain import build_chain
from cbsr_qa.simulate.sheet import SimulatedSheet
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.system.clock import Clock

Array = NDArray[np.float64]

#: Effects by name, in the scene's order, with the options a scene would give them.
Effects = Mapping[str, Mapping[str, Any]]

SEED: Final = 1
HEAD: Final = Indenter(13.0)
MOTION: Final = Motion(press_speed_mm_s=40 / 60, travel_speed_mm_s=10.0, hover_mm=25.0)
#: A press of 20 % strain takes this long at 40 mm/min on 4 mm.
RAMP_S: Final = 1.2
#: The nine places of the paper [mm].
NINE_MM: Final = ((0, 0), (30, 0), (-30, 0), (15, 15), (-15, 15), (15, -15), (-15, -15), (0, 30), (0, -30))

_MESH_MM: Final = 8.0  # twice as coarse as in a run: pictures do not show the difference

_sheets: Final[dict[str, SimulatedSheet]] = {}


@lru_cache
def _plugins() -> Plugins:
    return discover()


def effect_factory(name: str) -> Any:
    """What makes an effect."""
    return _plugins().factory(Kind.EFFECT, name)


def scene(effects: Effects) -> Scene:
    """The shipped scene without effects, with these."""
    choices = tuple(PluginChoice(name, dict(options)) for name, options in effects.items())
    return replace(load_scene("none").value, name="figure", effects=choices, sheet_mesh_size_mm=_MESH_MM)


@lru_cache
def sensor_type() -> SensorType:
    """The shipped disc of 100 mm."""
    return load_sensor_type("disc-100mm").value


@lru_cache
def material(name: str = "cbsr-8wt") -> Material:
    """A shipped material."""
    return load_material(name).value


def setting(*, head: Indenter = HEAD, seed: int = SEED) -> SceneSetting:
    """What effects are made with where no sheet is needed."""
    of = scene({})
    return SceneSetting(sensor_type(), material(), head, seed, of.current_A, of.frame_period_s)


def design(effects: Effects, seed: int = SEED) -> SheetDesign:
    """A sheet as effects of the stage ``sheet`` leave it."""
    of = setting(seed=seed)
    plain = SheetDesign.make_uniform(of.sensor_type, of.indenter)
    build_chain(scene(effects), of, effect_factory).design(plain)
    return plain


def world(effects: Effects, *presses: SimulatedPress, of: Material | None = None) -> SimulatedWorld:
    """A world with some effects, and what presses on it.

    Worlds of sheets alike share one, since meshing is what takes time.
    """
    chosen = of or material()
    on_sheet = [(name, options) for name, options in effects.items() if effect_factory(name).perturbs == "sheet"]
    key = f"{on_sheet} {chosen.interelectrode_resistance_ohm.value}"
    made = SimulatedWorld(
        scene(effects),
        sensor_type(),
        chosen,
        HEAD,
        seed=SEED,
        effect_factory=effect_factory,
        sheet=_sheets.get(key),
    )
    _sheets[key] = made.sheet
    made.presses.extend(presses)
    return made


def station(effects: Effects, clock: Clock) -> StationContext:
    """What a simulated bench is opened with."""
    return StationContext(
        "bench",
        clock,
        sensor_type(),
        material(),
        HEAD,
        SEED,
        {"scene": "figure"},
        scene=scene(effects),
        effect_factory=effect_factory,
        motion=MOTION,
    )


def press(*ramps: tuple[float, float, float], x_mm: float = 0.0, y_mm: float = 0.0) -> SimulatedPress:
    """A press from ramps (start, duration, change of strain)."""
    return SimulatedPress(0, x_mm, y_mm, [StrainRamp(*ramp) for ramp in ramps])


def change_of(made: SimulatedWorld, times_s: Array) -> Array:
    """Relative conductance change under the first press."""
    return np.array([made.truth(float(at))[0].relative_change for at in times_s])


def stress_of(made: SimulatedWorld, times_s: Array) -> Array:
    """Stress under the first press [kPa]."""
    return np.array([made.truth(float(at))[0].stress_kPa for at in times_s])


def force_of(made: SimulatedWorld, times_s: Array) -> Array:
    """What the load cell reads [N]."""
    return np.array([made.force_N(float(at), index) for index, at in enumerate(times_s)])


def neighbours_ohm(made: SimulatedWorld, time_s: float = 0.0) -> Array:
    """Resistance that the readings of driven pairs show, pair by pair [Ω]."""
    return np.diag(made.frame(time_s, 0).voltages) / made.setting.current_A
