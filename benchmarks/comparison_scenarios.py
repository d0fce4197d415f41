"""How often a comparison of batches is wrong where fleets are not as the simplest model takes them.

``python -m benchmarks.comparison_scenarios --fleets 2000`` simulates 3 batches × 20 sensors × 3 stations in ten
metrics, in units of the sensors' deviation; a run repeats to 0.3, stations differ by normal offsets of 1. No batch
differs, but in the last column, where the second batch reads 1.45 more in one metric. Prints, of each scenario, how
often any difference of batches is claimed (p < 0.05 after Holm over ten metrics and two batches), how often 95 %
intervals of batches and of stations hold, and how often the difference is found: by the additive model alone, and
by what ``cbsr-qa compare`` fits (sessions, scatter by batch, repeats at a station).
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import sys
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.stats.crossings import Crossing, crossing
from cbsr_qa.stats.difference import holm
from cbsr_qa.stats.mixed_model.model import fit
from cbsr_qa.studies.compare.models import Fitted, fit_model, include_sessions

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

METRICS, BATCHES, STATIONS, SENSORS = 10, 3, 3, 20
RUN, STATION, DIFFERENCE, LEVEL = 0.3, 1.0, 1.45, 0.05
SCENARIOS = (
    "base",
    "one sensor in a batch",
    "lognormal sensors",
    "outliers",
    "unequal scatter",
    "sensor × station",
    "session",
)


def design(scenario: str) -> Rows:
    """Return batch, station and sensor of each run, (N, 3): every third sensor runs on all stations."""
    rows = []
    for batch in range(BATCHES):
        count = 1 if scenario == "one sensor in a batch" and batch == 2 else SENSORS
        for index in range(count):
            stations = range(STATIONS) if index % 3 == 0 else [(index + batch) % STATIONS]
            repeats = 2 if scenario == "sensor × station" else 1
            rows += [(batch, station, SENSORS * batch + index) for station in stations for _ in range(repeats)]
    return np.array(rows)


def draw_values(rows: Rows, scenario: str, stations: Array, random: np.random.Generator) -> Array:
    """Draw the values of one metric, (N,), without a difference of batches."""
    batch, station, sensor = rows.T
    sensors = random.normal(size=BATCHES * SENSORS)
    if scenario == "lognormal sensors":
        sensors = (np.exp(sensors) - np.exp(0.5)) / np.sqrt((np.e - 1) * np.e)
    if scenario == "unequal scatter":
        sensors *= np.repeat([0.5, 1.0, 3.0], SENSORS)
    values: Array = sensors[sensor] + stations[station] + RUN * random.normal(size=len(rows))
    if scenario == "outliers":
        values += 6 * (random.random(len(rows)) < 0.03) * random.choice([-1, 1], size=len(rows))
    if scenario == "sensor × station":
        values += 0.7 * random.normal(size=(BATCHES * SENSORS, STATIONS))[sensor, station]
    if scenario == "session":
        values += 0.5 * random.normal(size=(BATCHES, STATIONS))[batch, station]
    return values


def fit_additive(fleet: Crossing, metrics: Sequence[Array]) -> list[Fitted]:
    """Fit the additive model to each metric."""
    return [Fitted(fit(fleet, values), "", of_stations=False) for values in metrics]


def fit_compared(fleet: Crossing, metrics: Sequence[Array]) -> list[Fitted]:
    """Fit what ``cbsr-qa compare`` fits."""
    return include_sessions([fit_model(fleet, values, "values", of_stations=False) for values in metrics])


def compare_batches(models: Sequence[Fitted], shift: float) -> tuple[Array, float]:
    """Return adjusted p values of all metrics (metrics, batches − 1), and the share of intervals that hold."""
    contrasts = [model.difference(f"b{batch:02d}", "b00") for model in models for batch in range(1, BATCHES)]
    truths = np.zeros((len(models), BATCHES - 1))
    truths[0, 0] = shift
    hold = np.mean([one.interval().holds(truth) for one, truth in zip(contrasts, truths.flat, strict=True)])
    return holm([contrast.p_value() for contrast in contrasts]).reshape(truths.shape), float(hold)


def hold_stations(models: Sequence[Fitted], stations: Sequence[Array]) -> float:
    """Return the share of station intervals that hold."""
    return float(
        np.mean(
            [
                model.fit.station_difference(f"s{second:02d}", f"s{first:02d}").interval().holds(truth)
                for model, offsets in zip(models, stations, strict=True)
                for first, second in combinations(range(STATIONS), 2)
                for truth in [float(offsets[second] - offsets[first])]
                if model.fit is not None
            ]
        )
    )


METHODS = {"additive model": fit_additive, "compare": fit_compared}


def measure(scenario: str, fleets: int) -> dict[str, Array]:
    """Return shares by method: false claims, intervals of batches and stations that hold, and differences found."""
    rows = design(scenario)
    names = [[f"{kind}{number:02d}" for number in column] for kind, column in zip("bsn", rows.T, strict=True)]
    fleet = crossing(*names)
    sums = {method: np.zeros(4) for method in METHODS}
    for seed in range(fleets):
        random = np.random.default_rng([9, SCENARIOS.index(scenario), seed])
        stations = [random.normal(size=STATIONS) for _ in range(METRICS)]
        metrics = [draw_values(rows, scenario, offsets, random) for offsets in stations]
        shifted = [metrics[0] + DIFFERENCE * (rows[:, 0] == 1), *metrics[1:]]
        for method, fit_all in METHODS.items():
            models = fit_all(fleet, metrics)
            p_values, hold = compare_batches(models, 0.0)
            shifted_p_values, _ = compare_batches(fit_all(fleet, shifted), DIFFERENCE)
            found = shifted_p_values[0, 0] < LEVEL
            sums[method] += p_values.min() < LEVEL, hold, hold_stations(models, stations), found
    return {method: total / fleets for method, total in sums.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleets", type=int, default=2000)
    parser.add_argument("--scenario", choices=SCENARIOS, action="append")
    options = parser.parse_args()
    sys.stdout.write("| fleet | method | false claims | batch intervals hold | station intervals hold | found |\n")
    sys.stdout.write("|" + " --- |" * 6 + "\n")
    for scenario in options.scenario or SCENARIOS:
        for method, shares in measure(scenario, options.fleets).items():
            cells = " | ".join(f"{100 * share:.1f} %" for share in shares)
            sys.stdout.write(f"| {scenario} | {method} | {cells} |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
