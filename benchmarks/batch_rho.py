"""How often the interval of what a batch's sensors have in common holds the truth.

``python -m benchmarks.batch_rho --batches 400`` draws batches of ten sensors, each pressed at 16 places of a
sunflower, whose maps vary by 20 % over 20 mm; a press scatters by 1.1 %. Prints, by ρ: the share of 95 % intervals
that hold it, and that lie above and below it; their width; the median error of its estimate; and seconds a batch.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import sys
import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.batch_maps import RADIUS_MM, draw_sensor, draw_smooth, place_sunflower
from cbsr_qa.calibration.batch.model import learn_batch

Array = NDArray[np.float64]
RHOS = (0.0, 0.5, 0.75, 0.9, 0.97)


def measure(rho: float, sensors: int, batches: int) -> Array:
    """Return low, value and high of ρ of each batch, and the seconds it took, (batches, 4)."""
    rows = []
    for seed in range(batches):
        random = np.random.default_rng([21, round(1000 * rho), sensors, seed])
        common, places_mm = draw_smooth(random), place_sunflower(16)
        loads = [draw_sensor(random, common, rho, draw_smooth).press(random, places_mm) for _ in range(sensors)]
        began = time.process_time()
        found = learn_batch(loads, radius_mm=RADIUS_MM).rho
        rows.append((found.low, found.value, found.high, time.process_time() - began))
    return np.array(rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.batch_rho", description=__doc__)
    parser.add_argument("--batches", type=int, default=400, help="of all ρ together")
    parser.add_argument("--sensors", type=int, default=10)
    chosen = parser.parse_args()
    print("| ρ | holds | above | below | width | error | s |\n| --- | --- | --- | --- | --- | --- | --- |")
    holds = []
    for rho in RHOS:
        low, value, high, seconds = measure(rho, chosen.sensors, chosen.batches // len(RHOS)).T
        above, below = float(np.mean(low > rho)), float(np.mean(high < rho))
        holds.append(1 - above - below)
        width, error = float(np.mean(high - low)), float(np.median(value) - rho)
        shares = f"{holds[-1]:.3f} | {above:.3f} | {below:.3f}"
        print(f"| {rho:g} | {shares} | {width:.3f} | {error:+.3f} | {np.mean(seconds):.2f} |")
        sys.stdout.flush()
    total = float(np.mean(holds))
    print(f"\n{total:.3f} ± {np.sqrt(total * (1 - total) / chosen.batches):.3f} of {chosen.batches} hold it")


if __name__ == "__main__":
    main()
