"""A calibration of a 100 mm disc with a force model learned from exact readings, and frames of loads on it."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from stored_runs import INDENTER, SENSOR_TYPE, calibration

from cbsr_qa.calibration.file.hdf5 import stamp
from cbsr_qa.calibration.force.learning import CalibrationLoads, learn_force
from cbsr_qa.calibration.force.templates import template_bank
from cbsr_qa.config.loader import load_material
from cbsr_qa.domain.kept import as_filed
from cbsr_qa.domain.results.calibration import Calibration, Validity
from cbsr_qa.eit.estimate.readings import load_model, merge_reciprocal
from cbsr_qa.eit.loads.round_load import RoundLoads

#: Volts of the sensor to those of its model, and the noise of a reading [V].
SCALE = 7.24
NOISE_V = 1.7e-4
_LINE = load_material("cbsr-8wt").value.against_stress
_PLACES = [(0, 0), (30, 0), (-30, 0), (15, 15), (-15, 15), (15, -15), (-15, -15), (0, 30), (0, -30), (36, 4)]


def response(places_mm: np.ndarray) -> np.ndarray:
    """How strongly each place answers."""
    x, y = np.asarray(places_mm, dtype=np.float64).T / 50
    return np.exp(0.2 * np.sin(2 * x + y) - 0.1 * y)


def frames(places_mm: np.ndarray, force_N: np.ndarray, noise: float = NOISE_V, seed: int = 2) -> np.ndarray:
    """Frames (n, 16, 16) [V] of one load each."""
    places = np.atleast_2d(np.asarray(places_mm, dtype=np.float64))
    stress_kPa = np.asarray(force_N, dtype=np.float64) / INDENTER.area_mm2 * 1e3
    contrast = response(places) * (_LINE.slope.value * stress_kPa + _LINE.intercept.value)
    loads = RoundLoads.from_contrast(places, np.full(len(places), INDENTER.radius_mm), contrast)
    model = load_model(SENSOR_TYPE)
    clean = SCALE * (model.solve_unloaded() + model.readings(loads).change)
    return clean + noise * np.random.default_rng(seed).standard_normal(clean.shape)


@lru_cache
def force_calibration() -> Calibration:
    """The calibration."""
    model, used = load_model(SENSOR_TYPE), SENSOR_TYPE.pattern.usable()
    variance = np.full(used.shape, (NOISE_V / SCALE) ** 2)
    readings = merge_reciprocal(SENSOR_TYPE.pattern, used, variance)
    merging, reference = readings.merging / SCALE, SCALE * model.solve_unloaded()
    places = np.array(_PLACES * 2, dtype=np.float64)
    force_N = np.linspace(1.0, 5.5, len(places))
    rows = (frames(places, force_N, NOISE_V / 2) - reference)[:, used] @ merging.T
    count = len(places)
    loads = CalibrationLoads(
        places, rows, np.full(count, 4), np.zeros_like(rows), np.zeros(count, int), force_N, np.full(count, 1e-3)
    )
    bank = template_bank(model, readings, INDENTER)
    learned = learn_force(bank, merging, loads, _LINE, INDENTER, radius_mm=SENSOR_TYPE.radius_mm)
    made = calibration(
        "0193-c",
        "0193-r",
        reference=reference,
        against_stress=learned.line,
        force=as_filed(replace(learned.model, steady_s=55.0)),
        validity=Validity((1.0, 5.5), (0.1, 0.3), None, 36.3),
        digest="",
        record_digest="",
    )
    return stamp(made)
