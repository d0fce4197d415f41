"""Whether places learned from a run's own presses pay, on simulated sensors that are as modelled and that are not.

``python -m benchmarks.run_places`` measures what docs/explanation/place.md states. Each sensor is pressed at the 39
places of the recipe ``campaign`` and by thirty random loads, as in :mod:`benchmarks.force_sensors` (10 s each).
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from numpy.typing import NDArray

from benchmarks.force_sensors import NINE, RANDOM, Sensors, observed
from cbsr_qa.analysis.evaluate import Conclusion, calibrate_run
from cbsr_qa.analysis.run.force import run_force
from cbsr_qa.analysis.run.loads import load_window
from cbsr_qa.analysis.run.place import PlaceErrors, run_place
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.results.observation import RunObservation

SENSORS = (
    Sensors("as modelled", effects=()),
    Sensors("response varies by 20 %, residue"),
    *(
        Sensors(
            f"conductance varies by {100 * deviation:.0f} %",
            effects=({"name": "uneven-conductance", "deviation": deviation, "correlation_mm": 10.0},),
        )
        for deviation in (0.2, 0.5)
    ),
    *(
        Sensors(
            f"readings keep {100 * share:.0f} % of the last", effects=({"name": "reading-memory", "share": share},)
        )
        for share in (0.3, 0.5)
    ),
)


@dataclass(frozen=True)
class Result:
    """One sensor: errors of presses left out of nine and 39, and of random loads by single frames in use."""

    nine: PlaceErrors
    all_places: PlaceErrors
    used: bool
    place_mm: tuple[float, float]
    force_N: tuple[float, float]
    learning_s: float


def result_of(run: RunObservation) -> Result:
    asked = replace(run, settings=replace(run.settings, learn_place=True))
    nine = run_place(replace(asked, settings=replace(asked.settings, calibrate_phases=(NINE,)))).left_out
    run_force(asked)
    begun = process_time()
    place = run_place(asked)
    learning_s = process_time() - begun
    assert nine is not None
    assert place.left_out is not None
    conclusion = Conclusion(asked, (), Verdict(Outcome.PASS, ""), ())
    issued, why = calibrate_run(
        conclusion, load_recipe("campaign").value, calibration="c", issued_at="2026-01-01T00:00:00+00:00"
    )
    assert issued is not None, why
    errors = [_errors(asked, Calibration(each)) for each in (issued, replace(issued, place=None))]
    place_mm, force_N = zip(*errors, strict=True)
    return Result(nine, place.left_out, place.pays, place_mm, force_N, learning_s)


def _errors(run: RunObservation, calibration: Calibration) -> tuple[float, float]:
    """Mean error of place [mm] and root mean square error of force [N] of the random loads, one frame each."""
    loads = [load for load in run.loads if load.phase == RANDOM]
    windows = [load_window(run.record.phase(RANDOM), load.record, run.settings) for load in loads]
    found = calibration.force(np.array([window.steady.voltages[-1] for window in windows]))
    apart = np.linalg.norm(found.place_mm - np.array([load.place_mm for load in loads]), axis=1)
    off: NDArray[np.float64] = found.force_N - np.array([load.force_N for load in loads])
    return float(apart.mean()), float(np.sqrt((off**2).mean()))


def table(count: int, first: int) -> Iterator[str]:
    columns = ("sensors", "9: learned, model", "39: learned, model", "used", "place", "force", "learning")
    yield f"| {' | '.join(columns)} |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for sensors in SENSORS:
        results = [result_of(observed(sensors, seed).run) for seed in range(first, first + count)]
        mean = [
            np.mean(values, axis=0)
            for values in (
                [(r.nine.learned_mm, r.nine.modelled_mm) for r in results],
                [(r.all_places.learned_mm, r.all_places.modelled_mm) for r in results],
                [r.place_mm for r in results],
                [r.force_N for r in results],
            )
        ]
        nine, places, place, force = (", ".join(f"{value:.2f}" for value in pair) for pair in mean)
        used = sum(r.used for r in results)
        learning = float(np.mean([r.learning_s for r in results]))
        yield (
            f"| {sensors.title} | {nine} mm | {places} mm | {used} of {count} | {place} mm | {force} N"
            f" | {learning:.1f} s |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.run_places", description=__doc__)
    parser.add_argument("--sensors", type=int, default=6, help="of each kind")
    parser.add_argument("--first-seed", type=int, default=7000)
    chosen = parser.parse_args()
    for line in table(chosen.sensors, chosen.first_seed):
        print(line, flush=True)


if __name__ == "__main__":
    main()
