"""How often the force error of a map is below the bound that is stated of it, on simulated maps.

``python -m benchmarks.error_bounds --maps 150`` presses sheets that vary by 20 % at places of a sunflower: smooth and
rough ones of several lengths, and two that the map does not assume. A map takes 0.1 s of one core.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
from collections.abc import Callable
from typing import Final

import numpy as np

from cbsr_qa.calibration.force.expected_error import LoadErrors, LoadsThatMatter, expect_force_error
from cbsr_qa.calibration.sheet.response_map import learn_response
from cbsr_qa.calibration.sheet.response_processes import compute_covariance
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.loads import sunflower_mm

_RADIUS_MM: Final = 50.0
_MATTER: Final = LoadsThatMatter(40.0, (0.05, 0.3))
#: Root mean square force of those loads on the 13 mm head, 8 wt% [N].
_LEVER_N: Final = 3.3
_NOISE: Final = 0.01
_CONFIDENCES: Final = (0.5, 0.8, 0.95)
Field = Callable[[Array, np.random.Generator], Array]


def make_field(smooth: bool, length_mm: float, deviation: float = 0.2) -> Field:
    """Return what draws a Gaussian field at places (n, 2)."""

    def draw(places_mm: Array, generator: np.random.Generator) -> Array:
        covariance = deviation**2 * compute_covariance(places_mm, places_mm, length_mm, smooth)
        root = np.linalg.cholesky(covariance + 1e-10 * np.eye(len(places_mm)))
        values: Array = root @ generator.standard_normal(len(places_mm))
        return values

    return draw


def two_lengths(places_mm: Array, generator: np.random.Generator) -> Array:
    """A field of 40 mm and one of 10 mm, 20 % together."""
    long, short = make_field(True, 40.0, 0.16), make_field(True, 10.0, 0.12)
    return long(places_mm, generator) + short(places_mm, generator)


def step(places_mm: Array, generator: np.random.Generator) -> Array:
    """Two halves of the sheet that differ by 40 %."""
    angle, shift_mm = generator.uniform(0, 2 * np.pi), generator.uniform(-20, 20)
    beyond: Array = np.where(places_mm @ np.array([np.cos(angle), np.sin(angle)]) > shift_mm, 0.4, 0.0)
    return beyond


FIELDS: Final[dict[str, Field]] = {
    "smooth, 20 mm": make_field(True, 20.0),
    "rough, 20 mm": make_field(False, 20.0),
    "smooth, 8 mm": make_field(True, 8.0),
    "smooth, 60 mm": make_field(True, 60.0),
    "two lengths": two_lengths,
    "a step": step,
}


def try_map(field: Field, count: int, seed: int) -> tuple[float, float, list[bool]]:
    """Return the true and the expected error of one map [N], and whether the true one is below each bound."""
    generator = np.random.default_rng(seed)
    places, targets = np.array(sunflower_mm(count, 40.0)), _MATTER.places_mm()
    values = field(np.vstack([places, targets]), generator)
    seen = values[:count] + _NOISE * generator.standard_normal(count)
    response = learn_response(places, seen, np.full(count, _NOISE**2), radius_mm=_RADIUS_MM)
    true_N = _LEVER_N * float(np.sqrt(np.mean((response.predict(targets)[0] - values[count:]) ** 2)))
    scatter_N = _LEVER_N * response.scatter  # of single loads, which these have not
    stated = [expect_force_error(response, targets, LoadErrors(_LEVER_N, 0.0, 0.0), level) for level in _CONFIDENCES]
    expected_N = float(np.sqrt(stated[0].expected_N ** 2 - scatter_N**2))
    return true_N, expected_N, [true_N**2 <= error.upper_N**2 - scatter_N**2 for error in stated]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.error_bounds", description=__doc__)
    parser.add_argument("--maps", type=int, default=40, help="of each kind and number of places")
    maps = parser.parse_args().maps
    for name, field in FIELDS.items():
        for count in (8, 12, 16, 20):
            tried = [try_map(field, count, seed) for seed in range(maps)]
            true_N, expected_N = (np.array([one[k] for one in tried]) for k in (0, 1))
            held = np.mean([one[2] for one in tried], axis=0)
            shares = ", ".join(f"{share:.0%} of {level:.0%}" for share, level in zip(held, _CONFIDENCES, strict=True))
            errors = f"error {true_N.mean():.3f} N, expected {expected_N.mean():.3f} N"
            print(f"{name}, {count} places: {errors}; bounds hold in {shares}", flush=True)


if __name__ == "__main__":
    main()
