"""A simulated sensor from the shipped files, for tests of the simulated world and bench."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from cbsr_qa.config.loader import load_material, load_scene, load_sensor_type
from cbsr_qa.domain.plan.plan import Motion, PluginChoice, Scene
from cbsr_qa.domain.plan.world import SimulatedPress, StrainRamp
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.electrodes import ElectrodeLayout
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Material, SensorType
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.instruments import StationContext
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.system.clock import Clock, VirtualClock

HEAD = Indenter(13.0)
MOTION = Motion(press_speed_mm_s=40 / 60, travel_speed_mm_s=10.0, hover_mm=25.0)


@lru_cache
def sensor_type() -> SensorType:
    return load_sensor_type("disc-100mm").value


def larger_sensor(count: int = 32) -> SensorType:
    """The same disc with more electrodes, read by adjacent pairs."""
    kind = sensor_type()
    assert isinstance(kind.electrodes, ElectrodeLayout)
    return replace(
        kind,
        name=f"disc of {count}",
        electrodes=replace(kind.electrodes, count=count),
        pattern=adjacent_pattern(count),
    )


@lru_cache
def material(name: str = "cbsr-8wt") -> Material:
    return load_material(name).value


def scene(*effects: str, **parameters: dict[str, Any]) -> Scene:
    """A scene with these effects, on a mesh coarse enough for quick tests; parameters by name with underscores."""
    choices = tuple(PluginChoice(name, parameters.get(name.replace("-", "_"), {})) for name in effects)
    return replace(load_scene("none").value, name="test", effects=choices, sheet_mesh_size_mm=5.0)


def base_scene() -> Scene:
    return replace(load_scene("base").value, sheet_mesh_size_mm=5.0)


@lru_cache
def _plugins() -> Any:
    return discover()


def installed(name: str) -> Callable[..., Any]:
    return _plugins().factory(Kind.EFFECT, name)


def world(
    of: Scene,
    *,
    kind: SensorType | None = None,
    seed: int = 1,
    effect_factory: Callable[[str], Callable[..., Any]] = installed,
    **more: Any,
) -> SimulatedWorld:
    return SimulatedWorld(
        of, kind or sensor_type(), material(), HEAD, seed=seed, effect_factory=effect_factory, **more
    )


def context(
    of: Scene | None,
    *,
    clock: Clock | None = None,
    seed: int = 1,
    options: dict[str, Any] | None = None,
    effect_factory: Callable[[str], Callable[..., Any]] | None = installed,
    resumed_at_s: float = 0.0,
) -> StationContext:
    return StationContext(
        "bench",
        clock or VirtualClock(),
        sensor_type(),
        material(),
        HEAD,
        seed,
        {"scene": "base"} | (options or {}),
        scene=of,
        effect_factory=effect_factory,
        motion=MOTION,
        resumed_at_s=resumed_at_s,
    )


def held(index: int, x_mm: float, y_mm: float, strain: float, start_s: float = 0.0) -> SimulatedPress:
    """A press that goes down in 1.2 s and stays."""
    return SimulatedPress(index, x_mm, y_mm, [StrainRamp(start_s, 1.2, strain)])


def pressed(index: int, x_mm: float, y_mm: float, strain: float, start_s: float = 0.0, hold_s: float = 60.0):
    """A press that goes down in 1.2 s, stays and comes up in 1.2 s."""
    press = held(index, x_mm, y_mm, strain, start_s)
    press.steps.append(StrainRamp(start_s + 1.2 + hold_s, 1.2, -strain))
    return press


@dataclass(frozen=True)
class Truth:
    """True state of one press: strain, relative change of the conductance and stress [kPa] under its head."""

    strain: float
    relative_change: float
    stress_kPa: float


def truth(of: SimulatedWorld, time_s: float) -> tuple[Truth, ...]:
    """The true state of every press of a world, before the sheet is measured."""
    moment = of._moment(time_s, 0, of.presses)
    of.chain.apply("response", moment)
    of.chain.apply("stress", moment)
    strains = [press.strain_at(time_s) for press in of.presses]
    return tuple(
        Truth(strain, change, max(stress, 0.0) if strain > 1e-9 else 0.0)
        for strain, change, stress in zip(strains, moment.response, moment.stress_kPa, strict=True)
    )
