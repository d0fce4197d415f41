"""How often a batch difference is found where stations differ as much, and how honest its interval is.

``python -m benchmarks.batch_coverage --seeds 1000`` simulates fleets of 3 batches × 20 sensors on 3 stations: 12 of a
batch's sensors belong to its own station, 8 to the others. The second batch lies 1.5 sensor deviations above the
others, the first station reads as much too high, a run repeats to 0.3. In one design each sensor runs on its own
station, in the other every third runs on all. Prints a table of the mixed model and of a t test without stations.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import sys
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.stats.crossings import crossing
from cbsr_qa.stats.difference import Contrast, welch
from cbsr_qa.stats.mixed_model.model import fit

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
#: Difference of two batches, given their numbers.
Compare = Callable[[int, int], Contrast]

BATCHES, STATIONS = np.array([0.0, 1.5, 0.0]), np.array([1.5, 0.0, 0.0])
RUN = 0.3
SENSORS, AT_HOME = 20, 12
DESIGNS = {"each sensor on one station": False, "a third on all stations": True}
#: Pairs that are compared, with their true differences.
PAIRS = {(1, 0): 1.5, (1, 2): 1.5, (2, 0): 0.0}


def design(on_all: bool) -> Rows:
    """Return batch, station and sensor of each run, (N, 3)."""
    rows = []
    for batch in range(len(BATCHES)):
        away = [(batch + 1 + index % 2) % 3 for index in range(SENSORS - AT_HOME)]
        homes = [batch] * AT_HOME + away
        for index in range(SENSORS):
            stations = range(3) if on_all and index % 3 == 0 else [homes[7 * index % SENSORS]]
            rows += [(batch, station, SENSORS * batch + index) for station in stations]
    return np.array(rows)


def values(rows: Rows, seed: int) -> Array:
    """Draw one value a run, in sensor deviations."""
    random = np.random.default_rng([8, seed])
    sensors = random.normal(size=len(BATCHES) * SENSORS)[rows[:, 2]]
    drawn: Array = BATCHES[rows[:, 0]] + STATIONS[rows[:, 1]] + sensors + RUN * random.normal(size=len(rows))
    return drawn


def counted(rows: Rows, seeds: int) -> dict[str, Array]:
    """Return, of each method, how often intervals hold, the difference is found, and an absent one is found."""
    names = [[f"{kind}{number:02d}" for number in column] for kind, column in zip("bsn", rows.T, strict=True)]
    fleet, sums = crossing(*names), {"mixed model": np.zeros(3), "t test": np.zeros(3)}
    for seed in range(seeds):
        drawn = values(rows, seed)
        model, apart = fit(fleet, drawn), [drawn[rows[:, 0] == batch] for batch in range(3)]
        ways: dict[str, Compare] = {
            "mixed model": lambda one, two, model=model: model.group_difference(f"b{one:02d}", f"b{two:02d}"),
            "t test": lambda one, two, apart=apart: welch(apart[one], apart[two]),
        }
        for name, compare in ways.items():
            sums[name] += tallied(compare)
    return {name: 100 * total / seeds for name, total in sums.items()}


def tallied(compare: Compare) -> Array:
    """Return the share of intervals that hold, and whether the first pair and the equal one are said to differ."""
    intervals = {pair: compare(*pair).interval() for pair in PAIRS}
    held = np.mean([intervals[pair].holds(truth) for pair, truth in PAIRS.items()])
    return np.array([held, intervals[1, 0].low > 0, not intervals[2, 0].holds(0.0)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1000)
    seeds = parser.parse_args().seeds
    lines = ["| design | method | 95 % intervals that hold | found | found when absent |", "|" + " --- |" * 5]
    for title, on_all in DESIGNS.items():
        for name, (held, found, false) in counted(design(on_all), seeds).items():
            lines.append(f"| {title} | {name} | {held:.1f} % | {found:.1f} % | {false:.1f} % |")
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
