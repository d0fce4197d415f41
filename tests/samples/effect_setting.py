"""A setting and histories for tests of single effects."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from simulated_setting import world

from cbsr_qa.config.loader import load_material, load_sensor_type
from cbsr_qa.domain.plan.plan import PluginChoice, Scene
from cbsr_qa.domain.plan.world import Moment, SceneSetting, SheetDesign, SimulatedPress, StrainRamp
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.sensor_type import Material, Parameter, QuasiStatic, Relaxation, SensorType
from cbsr_qa.simulate.sheet import SimulatedSheet
from cbsr_qa.simulate.world import SimulatedWorld

STEP_S = 1e-9  #: a ramp this short is a step
READING_SCALE_V = 2.0


@cache
def _shipped() -> tuple[SensorType, Material]:
    return load_sensor_type("disc-100mm").value, load_material("cbsr-8wt").value


def setting(material: Material | None = None, *, seed: int = 1) -> SceneSetting:
    sensor_type, shipped = _shipped()
    return SceneSetting(sensor_type, material or shipped, Indenter(13.0), seed, 1e-3)


@cache
def plain_sheet() -> SimulatedSheet:
    """The setting's sheet, on a coarse mesh."""
    design = SheetDesign.make_uniform(setting().sensor_type, setting().indenter)
    return SimulatedSheet(design, size_mm=8.0, interelectrode_resistance_ohm=1e4)


def world_of(*effects: tuple[str, dict[str, Any]], seed: int = 1, **more: Any) -> SimulatedWorld:
    """The setting's sheet under effects with their options, on a coarse mesh."""
    return world(
        Scene("t", tuple(PluginChoice(*effect) for effect in effects), 4e-4, 2.5, 8.0, ()), seed=seed, **more
    )


def with_line(slope: float, intercept: float) -> Material:
    line = QuasiStatic(Parameter(slope, None, "test"), Parameter(intercept, None, "test"))
    return replace(_shipped()[1], against_strain=line)


def moment(of: SceneSetting, time_s: float, *presses: SimulatedPress, index: int = 0) -> Moment:
    return Moment(
        of, time_s, index, list(presses), [0.0] * len(presses), [0.0] * len(presses), reading_scale_V=READING_SCALE_V
    )


def applied(effect: Any, at: Moment, **fields: Any) -> Moment:
    """What an effect makes of a moment with these fields."""
    for name, value in fields.items():
        setattr(at, name, value)
    effect.apply(at)
    return at


def history(*ramps: tuple[float, float, float]) -> SimulatedPress:
    """A press from ramps (start, duration, change of strain)."""
    return SimulatedPress(0, 0.0, 0.0, [StrainRamp(*ramp) for ramp in ramps])


def kernel(relaxation: Relaxation, time_s: float) -> float:
    """1 + w₁ e^(−t/τ₁) + w₂ e^(−t/τ₂)."""
    pairs = zip(relaxation.weights, relaxation.time_constants_s, strict=True)
    return 1 + sum(weight * math.exp(-time_s / tau) for weight, tau in pairs)


def last_outside(times: np.ndarray, values: np.ndarray, band: float) -> float:
    """Last time at which a trace is further from zero than a band."""
    return float(times[np.abs(values) > band][-1])
