"""A recipe that decides between presses, on simulated sensors: what it takes, and whether its error is what it says.

``python -m benchmarks.adaptive_recipe --seeds 5001:5021`` calibrates a sensor a seed by the shipped recipe
``adaptive`` and tests it on thirty random loads; ``--recipe FILE`` by another, ``--curve`` also after each press, for
the error against station time. A sensor takes 30 s of one core, with the curve 45 s.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from cbsr_qa.analysis.run.force import force_tests, learn_without_tests
from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.station.decisions import cut_record
from cbsr_qa.studies.frontier.sensors import analyse_run, load_analysis, simulate_sensor
from cbsr_qa.studies.frontier.setting import HELD_OUT, phase_of_test_loads
from cbsr_qa.studies.frontier.trial import select_loads

_TEST_LOADS = 30


@dataclass(frozen=True)
class Tried:
    """One sensor: presses and minutes of its calibration, the error it expected with its bound, and the true one."""

    presses: int
    minutes: float
    expected_N: float
    upper_N: float
    error_N: float
    why: str


def try_sensor(recipe: dict[str, Any], seed: int, *, curve: bool) -> list[Tried]:
    """Calibrate one sensor; return its end, before that each press that was decided from a map."""
    record, _ = simulate_sensor(recipe, seed)
    settings = load_analysis(recipe)
    held_out = select_loads(analyse_run(record, settings), lambda load: load.phase == HELD_OUT)
    made = [made for made in record.decisions if made.expected_N is not None and (curve or made.ends)]
    return [
        Tried(
            presses=_count_presses(record, decided.phase, decided.pressed),
            minutes=decided.time_s / 60,
            expected_N=decided.expected_N or np.nan,
            upper_N=decided.upper_N or np.nan,
            error_N=_error_N(cut_record(record, decided.phase, decided.pressed), held_out, settings),
            why=decided.why,
        )
        for decided in made
    ]


def _count_presses(record: RunRecord, phase: int, pressed: int) -> int:
    return pressed + sum(len(earlier.loads) for earlier in record.phases[:phase])


def _error_N(record: RunRecord, held_out: RunObservation, settings: AnalysisSettings) -> float:
    learned = learn_without_tests(analyse_run(record, settings)).learned
    assert learned is not None
    errors = [test.known_N - test.measured_N for test in force_tests(held_out, learned)]
    return float(np.sqrt(np.mean(np.square(errors))))


def summary(tried: list[Tried], target_N: float) -> Iterator[str]:
    """Means over the sensors with standard errors, and how often target and bound hold."""
    for name in ("presses", "minutes", "expected_N", "error_N"):
        values = np.array([getattr(one, name) for one in tried])
        yield f"{name}: {values.mean():.3f} ± {values.std(ddof=1) / np.sqrt(len(values)):.3f}"
    errors, bounds = (np.array([getattr(one, name) for one in tried]) for name in ("error_N", "upper_N"))
    at_target = np.mean([one.why == "target" for one in tried])
    yield (
        f"error below the target in {np.mean(errors <= target_N):.0%}, below its bound in"
        f" {np.mean(errors <= bounds):.0%}; ended at the target in {at_target:.0%}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.adaptive_recipe", description=__doc__)
    parser.add_argument("--seeds", default="5001:5004", help="first and one after the last; two at least")
    parser.add_argument("--recipe", default="adaptive", help="name or file")
    parser.add_argument("--curve", action="store_true")
    options = parser.parse_args()
    recipe = dict(open_document(DocumentKind.RECIPE, options.recipe).data)
    recipe["phases"] = [*recipe["phases"], phase_of_test_loads(_TEST_LOADS)]
    ends = []
    for seed in range(*map(int, options.seeds.split(":"))):
        *before, end = try_sensor(recipe, seed, curve=options.curve)
        ends.append(end)
        for one in (*before, end):
            print(
                f"sensor {seed}: {one.presses} presses, {one.minutes:.2f} min, expected {one.expected_N:.3f} N, bound"
                f" {one.upper_N:.3f} N, error {one.error_N:.3f} N, {one.why}",
                flush=True,
            )
    (target_N,) = (phase["target_N"] for phase in recipe["phases"] if "target_N" in phase)
    print("\n".join(summary(ends, target_N)))


if __name__ == "__main__":
    main()
