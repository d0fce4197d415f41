"""What the batch as prior does to a sensor's map, also where maps are not what the model assumes.

``python -m benchmarks.batch_maps --batches 20 --sensors 5`` draws batches of N earlier sensors of 16 presses, and
new sensors of 4, 9 and 16 presses; maps vary by 20 %, a press scatters by 1.1 %. Prints, by kind of map, ρ, N and
presses: the error of the new sensor's response with the batch and without (root mean square over the area, %), their
ratio with its standard error, in pairs by batch; the share of further presses within intervals of 68 and 95 %, with
the batch and without; the share of sensors of the batch, and of another one, that are named as unlike. A sensor that
is named counts as one without a batch.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cbsr_qa.calibration.batch.learning import is_strange
from cbsr_qa.calibration.batch.loads import SensorLoads
from cbsr_qa.calibration.batch.model import learn_batch
from cbsr_qa.calibration.batch.prior import BatchPrior
from cbsr_qa.calibration.sheet.response_map import learn_response

Array = NDArray[np.float64]
Field = Callable[[Array], Array]
RADIUS_MM, REACH_MM = 50.0, 40.0
RHOS, EARLIER, PRESSES = (0.0, 0.5, 0.75, 0.9), (5, 10, 30), (4, 9, 16)
_DEVIATION, _NOISE, _SCATTER = float(np.sqrt(np.log1p(0.2**2))), 0.005, 0.01
_WAVES = 400


def place_sunflower(count: int) -> Array:
    """Places (count, 2) of a sunflower over the disc of 40 mm."""
    number = np.arange(count)
    radius, angle = REACH_MM * np.sqrt((number + 0.5) / count), number * np.pi * (3 - np.sqrt(5))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def draw_smooth(random: np.random.Generator, length_mm: float = 20.0) -> Field:
    """Draw a Gaussian field of variance one, as the effect ``batch-pattern`` does."""
    waves, phases = random.standard_normal((_WAVES, 2)) / length_mm, random.uniform(0, 2 * np.pi, _WAVES)

    def field(places_mm: Array) -> Array:
        values: Array = np.sqrt(2 / _WAVES) * np.cos(places_mm @ waves.T + phases).sum(axis=1)
        return values

    return field


def _draw_two_lengths(random: np.random.Generator) -> Field:
    short, long = draw_smooth(random, 8.0), draw_smooth(random, 40.0)
    return lambda places: np.sqrt(0.3) * short(places) + np.sqrt(0.7) * long(places)


def _draw_step(random: np.random.Generator) -> Field:
    smooth, angle, offset_mm = draw_smooth(random), random.uniform(0, 2 * np.pi), random.uniform(-20, 20)
    direction = np.array([np.cos(angle), np.sin(angle)])
    return lambda places: np.sqrt(0.5) * (smooth(places) + np.sign(places @ direction - offset_mm))


def _draw_heavy(random: np.random.Generator) -> Field:
    smooth = draw_smooth(random)
    return lambda places: stats.t.ppf(stats.norm.cdf(smooth(places)), 3) / np.sqrt(3)


def _draw_gradient(random: np.random.Generator) -> Field:
    smooth, slope = draw_smooth(random), random.standard_normal(2) / (REACH_MM / 2)
    return lambda places: np.sqrt(0.5) * (smooth(places) + places @ slope)


FAMILIES: dict[str, Callable[[np.random.Generator], Field]] = {
    "20 mm": draw_smooth,
    "two lengths": _draw_two_lengths,
    "a step": _draw_step,
    "heavy tails": _draw_heavy,
    "a gradient": _draw_gradient,
    "8 mm": lambda random: draw_smooth(random, 8.0),
    "60 mm": lambda random: draw_smooth(random, 60.0),
}


@dataclass(frozen=True)
class Sensor:
    """A sensor's logarithm of the response, as a function of place."""

    response: Field

    def press(self, random: np.random.Generator, places_mm: Array) -> SensorLoads:
        """Press once at every place."""
        noise = np.hypot(_NOISE, _SCATTER) * random.standard_normal(len(places_mm))
        return SensorLoads(places_mm, self.response(places_mm) + noise, np.full(len(places_mm), _NOISE**2))


def draw_sensor(
    random: np.random.Generator, common: Field, rho: float, draw: Callable[[np.random.Generator], Field]
) -> Sensor:
    """Draw a sensor that shares ρ of the variance of its map."""
    own = draw(random)
    return Sensor(lambda places: _DEVIATION * (np.sqrt(rho) * common(places) + np.sqrt(1 - rho) * own(places)))


def measure(family: str, rho: float, earlier: int, batches: int, sensors: int) -> dict[int, Array]:
    """By presses: squared errors with and without, coverages, named, (batches, sensors, 8)."""
    draw, there_mm = FAMILIES[family], place_sunflower(80)
    rows: dict[int, list[list[tuple[float, ...]]]] = {count: [] for count in PRESSES}
    for seed in range(batches):
        random = np.random.default_rng([22, list(FAMILIES).index(family), round(1000 * rho), earlier, seed])
        common = draw(random)
        learned = [draw_sensor(random, common, rho, draw).press(random, place_sunflower(16)) for _ in range(earlier)]
        prior = learn_batch(learned, radius_mm=RADIUS_MM).prior
        new = [draw_sensor(random, common, rho, draw) for _ in range(sensors)]
        strange = [draw_sensor(random, draw(random), rho, draw) for _ in range(sensors)]
        for count in PRESSES:
            places_mm = place_sunflower(count)
            rows[count].append(
                [
                    _compare(
                        random, prior, one, other.press(random, places_mm), one.press(random, places_mm), there_mm
                    )
                    for one, other in zip(new, strange, strict=True)
                ]
            )
    return {count: np.array(of_count) for count, of_count in rows.items()}


def _compare(
    random: np.random.Generator,
    prior: BatchPrior,
    sensor: Sensor,
    strange: SensorLoads,
    loads: SensorLoads,
    there_mm: Array,
) -> tuple[float, ...]:
    further, values = sensor.press(random, there_mm).log_response, []
    truth = sensor.response(there_mm)
    unlike = is_strange(prior.test_likeness(loads))
    alone = learn_response(loads.places_mm, loads.log_response, loads.variance, radius_mm=RADIUS_MM)
    for learned in (alone if unlike else prior.learn_response(loads), alone):
        mean, variance = learned.predict(there_mm)
        off = np.abs(mean - further) / np.sqrt(variance + learned.scatter**2 + _NOISE**2)
        values.append((float(np.mean((mean - truth) ** 2)), float(np.mean(off < 1)), float(np.mean(off < 1.96))))
    (squared, *inside), (squared_alone, *inside_alone) = values
    strange_is_named = is_strange(prior.test_likeness(strange))
    return (squared, squared_alone, *inside, *inside_alone, float(unlike), float(strange_is_named))


def _print_row(name: str, found: Array) -> None:
    means = found.mean(axis=(0, 1))
    by_batch = found[:, :, :2].mean(axis=1)
    ratio = float(np.sqrt(means[0] / means[1]))
    # Of the ratio of two means, by the delta method over batches.
    relative = by_batch[:, 0] / means[0] - by_batch[:, 1] / means[1]
    error = ratio / 2 * float(relative.std(ddof=1)) / np.sqrt(len(relative))
    errors = f"{100 * np.sqrt(means[0]):.2f} | {100 * np.sqrt(means[1]):.2f} | {ratio:.3f} ± {error:.3f}"
    inside = " | ".join(f"{100 * share:.0f}, {100 * wide:.0f}" for share, wide in (means[2:4], means[4:6]))
    print(f"| {name} | {errors} | {inside} | {100 * means[6]:.0f} | {100 * means[7]:.0f} |")
    sys.stdout.flush()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.batch_maps", description=__doc__)
    parser.add_argument("--batches", type=int, default=20)
    parser.add_argument("--sensors", type=int, default=5)
    parser.add_argument("--family", choices=FAMILIES, action="append")
    parser.add_argument("--rho", type=float, action="append")
    parser.add_argument("--earlier", type=int, action="append")
    chosen = parser.parse_args()
    columns = "maps | ρ | N | presses | with [%] | without [%] | ratio | inside | inside without | named | strangers"
    print(f"| {columns} |\n|{' --- |' * (columns.count('|') + 1)}")
    for family in chosen.family or FAMILIES:
        for rho in chosen.rho or RHOS:
            for earlier in chosen.earlier or EARLIER:
                found = measure(family, rho, earlier, chosen.batches, chosen.sensors)
                for count, rows in found.items():
                    _print_row(f"{family} | {rho:g} | {earlier} | {count}", rows)


if __name__ == "__main__":
    main()
