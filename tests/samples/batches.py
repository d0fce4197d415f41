"""Batches of simulated maps, as the effect ``batch-pattern`` draws them."""

import numpy as np

from cbsr_qa.calibration.batch.loads import SensorLoads

RADIUS_MM = 50.0
_WAVES = 400
_NOISE, _SCATTER = 0.005, 0.01
_DEVIATION = float(np.sqrt(np.log1p(0.2**2)))


def place_sunflower(count, radius_mm=40.0):
    number = np.arange(count)
    radius, angle = radius_mm * np.sqrt((number + 0.5) / count), number * np.pi * (3 - np.sqrt(5))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def draw_field(random, length_mm=20.0):
    waves, phases = random.standard_normal((_WAVES, 2)) / length_mm, random.uniform(0, 2 * np.pi, _WAVES)
    return lambda places: np.sqrt(2 / _WAVES) * np.cos(places @ waves.T + phases).sum(axis=1)


def draw_map(random, common, rho):
    own = draw_field(random)
    return lambda places: _DEVIATION * (np.sqrt(rho) * common(places) + np.sqrt(1 - rho) * own(places))


def press(random, response, places):
    noise = np.hypot(_NOISE, _SCATTER) * random.standard_normal(len(places))
    return SensorLoads(places, response(places) + noise, np.full(len(places), _NOISE**2))


def draw_batch(random, rho, sensors=10, places=16):
    """Loads of a batch's sensors, and its common map."""
    common, at = draw_field(random), place_sunflower(places)
    return [press(random, draw_map(random, common, rho), at) for _ in range(sensors)], common
