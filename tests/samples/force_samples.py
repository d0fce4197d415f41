"""Sensors whose readings are exact, with a response that is known everywhere: for tests of what force is made of."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace

import numpy as np

from cbsr_qa.calibration.force.learning import CalibrationLoads, LearnedForce, learn_force
from cbsr_qa.calibration.force.templates import TemplateBank, template_bank
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.config.loader import load_material, load_sensor_type
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.calibration import ForceModel, Validity
from cbsr_qa.domain.sensor.sensor_type import QuasiStatic
from cbsr_qa.eit.estimate.readings import MergedReadings, load_model, merge_reciprocal
from cbsr_qa.eit.loads.round_load import RoundLoadModel, RoundLoads

SENSOR_TYPE = load_sensor_type("disc-100mm").value
HEAD = Indenter(13.0)
#: Noise of a reading [V/A at unit sheet conductance], of the order of the simulated 8 wt% sensor's.
NOISE = 2.4e-5


@dataclass(frozen=True, eq=False)
class Setting:
    model: RoundLoadModel
    readings: MergedReadings
    bank: TemplateBank
    used: np.ndarray

    def rows(self, places_mm: np.ndarray, contrast: np.ndarray, head: Indenter = HEAD) -> np.ndarray:
        """Rows of unit noise without noise, by the exact model."""
        loads = RoundLoads.from_contrast(places_mm, np.full(len(places_mm), head.radius_mm), contrast)
        return self.readings.merge_frames(self.model.readings(loads).change)

    def voltages(self, places_mm: np.ndarray, contrast: np.ndarray) -> np.ndarray:
        """Whole changes (n, drives, measures) of the readings, without noise."""
        loads = RoundLoads.from_contrast(places_mm, np.full(len(places_mm), HEAD.radius_mm), contrast)
        return self.model.readings(loads).change


@lru_cache
def setting() -> Setting:
    pattern = SENSOR_TYPE.pattern
    model, used = load_model(SENSOR_TYPE), pattern.usable()
    readings = merge_reciprocal(pattern, used, np.full(pattern.shape, NOISE**2))
    return Setting(model, readings, template_bank(model, readings, HEAD), used)


@lru_cache
def line(name: str = "cbsr-8wt") -> QuasiStatic:
    return load_material(name).value.against_stress


def somewhere(random: np.random.Generator, count: int, radius_mm: float = 40.0) -> np.ndarray:
    """Places spread evenly over a disc."""
    radius, angle = radius_mm * np.sqrt(random.uniform(size=count)), random.uniform(0, 2 * np.pi, count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def smooth_response(seed: int, deviation: float = 0.2, length_mm: float = 20.0) -> Callable[[np.ndarray], np.ndarray]:
    """A response that varies smoothly with place, 1 on (geometric) average over all sheets."""
    random = np.random.default_rng(seed)
    waves = random.standard_normal((200, 2)) / length_mm
    phases = random.uniform(0, 2 * np.pi, 200)
    spread = np.sqrt(np.log1p(deviation**2))
    return lambda places: np.exp(spread * np.sqrt(2 / 200) * np.cos(places @ waves.T + phases).sum(axis=1))


def pressed(
    random: np.random.Generator,
    response: Callable[[np.ndarray], np.ndarray],
    places_mm: np.ndarray,
    force_N: np.ndarray,
    *,
    truth: QuasiStatic | None = None,
    frames: int = 4,
) -> CalibrationLoads:
    """Loads as a calibration sees them: readings with noise, a load cell with a little."""
    of = truth or line()
    contrast = response(places_mm) * (of.slope.value * force_N / HEAD.area_mm2 * 1e3 + of.intercept.value)
    clean = setting().rows(places_mm, contrast)
    count = len(places_mm)
    return CalibrationLoads(
        place_mm=places_mm,
        rows=clean + random.standard_normal(clean.shape) / np.sqrt(frames),
        frames=np.full(count, frames),
        before=np.zeros_like(clean),
        frames_before=np.zeros(count, dtype=np.int64),
        force_N=force_N + 1e-3 * random.standard_normal(count),
        force_stderr_N=np.full(count, 1e-3),
    )


def learned(loads: CalibrationLoads, *, of: QuasiStatic | None = None) -> LearnedForce:
    here = setting()
    merging = here.readings.merging
    return learn_force(here.bank, merging, loads, of or line(), HEAD, radius_mm=50.0)


def in_use(model: ForceModel, against_stress: QuasiStatic) -> Calibration:
    """A calibration of the setting with this model, ready to be applied."""
    here = setting()
    issued = SimpleNamespace(
        force=model,
        calibration="c",
        sensor=SimpleNamespace(serial="S-1"),
        place=None,
        standards=(),
        reference=here.model.solve_unloaded(),
        current_A=1.0,
        indenter=HEAD,
        against_stress=against_stress,
        validity=Validity((0.5, 6.0), (0.05, 0.3), None, 40.0),
        reconstruction=SimpleNamespace(problem=SimpleNamespace(used=here.used, sensor_type=SENSOR_TYPE)),
    )
    return Calibration(issued)
