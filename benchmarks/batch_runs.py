"""Whole simulated runs with and without the batch as prior: force error against minutes of the station.

``python -m benchmarks.batch_runs --rho 0.9 --earlier 10 --sensors 20`` simulates a batch whose sensors share ρ of the
variance of their maps (20 % over 20 mm, with a residue of 3 % that fades in five minutes), tests the earlier ones by
``frontier``'s recommended recipe, learns the batch's model, and calibrates further sensors by the recipes named. Each
is tested on thirty random loads held for a minute, its places known. Prints presses, minutes, the root mean square
error of force, the share of forces inside their intervals of 68 and 95 %, and how many sensors were named as unlike
their batch. ``--of-batch OTHER`` draws the further sensors from another batch.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.run.force import force_tests, learn_without_tests
from cbsr_qa.analysis.run.long_holds import find_long_holds
from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.calibration.batch.model import learn_batch
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.merging import BATCH_LAYOUT, Configuration, add_batch_model, digest_batch_model
from cbsr_qa.domain.plan.batch_model import KeptBatch, KeptMember, KeptSensor
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.studies.batch.relaxation import learn_relaxation
from cbsr_qa.studies.batch.sensors import map_loads
from cbsr_qa.studies.frontier.setting import HELD_OUT, Setting, phase_of_test_loads
from cbsr_qa.studies.frontier.trial import select_loads
from cbsr_qa.studies.simulated import configuration_of, copy_shipped, simulate_run

Array = NDArray[np.float64]

#: What the earlier sensors are tested by.
EARLIER = Setting(16, hold_s=15.0, rest_s=5.0, predicted=True)
TEST_LOADS = 30
_SCENE = "base"


@dataclass(frozen=True)
class Tested:
    """One sensor: presses, minutes of the station, error of force [N], shares inside intervals, alike or not."""

    presses: int
    minutes: float
    error_N: float
    inside_68: float
    inside_95: float
    alike: bool
    p_value: float


def configure(recipe: Mapping[str, Any], seed: int, batch: str, rho: float) -> Configuration:
    """Return the configuration of one sensor of a batch at the simulated station."""
    station, scene = copy_shipped(DocumentKind.STATION, "simulated"), copy_shipped(DocumentKind.SCENE, _SCENE)
    pattern = {"name": "batch-pattern", "rho": rho, "batch": batch, "deviation": 0.2, "correlation_mm": 20.0}
    scene["effects"] = [*scene["effects"], pattern, {"name": "residue", "share": 0.03, "decay_s": 300.0}]
    station["instruments"]["bench"]["scene"] = scene
    return configuration_of(station, recipe, seed=seed)


def observe(configuration: Configuration, serial: str) -> RunObservation:
    """Simulate a run and image it."""
    record, _ = simulate_run(configuration, serial, discover())
    assert record.end is EndReason.FINISHED, record.end_detail
    recipe = configuration.recipe
    return observe_run(record, _create_method(recipe.reconstruction.name), recipe.analysis, over_time=False)


@lru_cache(maxsize=4)
def _create_method(name: str) -> Any:
    recipe = copy_shipped(DocumentKind.RECIPE, "campaign")
    assert recipe["reconstruction"]["method"] == name
    choice = configuration_of(copy_shipped(DocumentKind.STATION, "simulated"), recipe, seed=0).recipe.reconstruction
    return create_plugin(discover(), Kind.RECONSTRUCTION, choice, "[reconstruction]")


def learn_model(batch: str, rho: float, earlier: int, seed: int) -> KeptBatch:
    """Test the earlier sensors of a batch, and learn its model."""
    loads, holds = [], []
    for number in range(earlier):
        run = observe(configure(EARLIER.recipe(), seed + number, batch, rho), f"E{number}")
        loads.append(map_loads(run, learn_without_tests(run)))
        holds.append(find_long_holds(run))
    model = learn_batch(loads, radius_mm=50.0)
    station = configuration_of(copy_shipped(DocumentKind.STATION, "simulated"), EARLIER.recipe(), seed=0)
    sensors = tuple(
        KeptSensor(
            serial=f"E{number}",
            run=f"E{number}",
            chain_head="",
            places_mm=tuple((x, y) for x, y in sensor.places_mm.tolist()),
            log_response=tuple(sensor.log_response.tolist()),
            variance=tuple(sensor.variance.tolist()),
            bend=None if sensor.bend is None else tuple(sensor.bend.tolist()),
            bend_stderr=sensor.bend_stderr,
        )
        for number, sensor in enumerate(loads)
    )
    members = tuple(
        KeptMember(**asdict(choice), weight=weight)
        for choice, weight in zip(model.choices, model.weights, strict=True)
    )
    kept = KeptBatch(
        layout=BATCH_LAYOUT,
        digest=f"{batch} {rho:g} {earlier}",
        content_sha256="",
        batch=batch,
        sensor_type=station.sensor_type.name,
        material=station.material.name,
        head_mm=station.station.indenter.diameter_mm,
        radius_mm=50.0,
        sensors=sensors,
        members=members,
        relaxation=learn_relaxation(holds),
    )
    sys.stdout.write(f"batch {batch}: rho {model.rho.value:.2f} ({model.rho.low:.2f} to {model.rho.high:.2f})\n")
    return replace(kept, content_sha256=digest_batch_model(asdict(kept)))


def test_sensor(recipe: Mapping[str, Any], seed: int, batch: str, rho: float, kept: KeptBatch) -> Tested:
    """Calibrate one sensor by a recipe, and test it on random loads."""
    phases = [*recipe["phases"], phase_of_test_loads(TEST_LOADS)]
    configuration = configure({**recipe, "phases": phases}, seed, batch, rho)
    if configuration.recipe.analysis.prior == "batch":
        configuration = add_batch_model(configuration, kept)
    run = observe(configuration, f"N{seed}")
    calibrating = select_loads(run, lambda load: load.phase != HELD_OUT)
    held_out = select_loads(run, lambda load: load.phase == HELD_OUT)
    learned = learn_without_tests(calibrating).learned
    assert learned is not None
    tests = force_tests(held_out, learned)
    errors = np.array([test.known_N - test.measured_N for test in tests])
    stderrs = np.array([test.known_stderr_N for test in tests])
    use = learned.model.batch
    return Tested(
        presses=len(calibrating.loads),
        minutes=run.record.phases[-2].ended_s / 60,
        error_N=float(np.sqrt(np.mean(errors**2))),
        inside_68=float(np.mean(np.abs(errors) <= stderrs)),
        inside_95=float(np.mean(np.abs(errors) <= 1.96 * stderrs)),
        alike=use is None or use.alike,
        p_value=1.0 if use is None else use.p_value,
    )


def describe(name: str, tested: Sequence[Tested]) -> str:
    """Return a row of the table."""

    def mean(values: Sequence[float], digits: int) -> str:
        stderr = np.std(values, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else float("nan")
        return f"{np.mean(values):.{digits}f} ± {stderr:.{digits}f}"

    cells = (
        name,
        mean([one.presses for one in tested], 1),
        mean([one.minutes for one in tested], 1),
        mean([one.error_N for one in tested], 3),
        mean([100 * one.inside_68 for one in tested], 0),
        mean([100 * one.inside_95 for one in tested], 0),
        str(sum(not one.alike for one in tested)),
    )
    return f"| {' | '.join(cells)} |\n"


def load_recipe_table(name: str) -> dict[str, Any]:
    """Return a shipped recipe, or that of a TOML file."""
    if not name.endswith(".toml"):
        return copy_shipped(DocumentKind.RECIPE, name)
    import tomllib

    return tomllib.loads(Path(name).read_text(encoding="utf-8"))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.batch_runs", description=__doc__)
    parser.add_argument("--rho", type=float, default=0.9)
    parser.add_argument("--earlier", type=int, default=10)
    parser.add_argument("--sensors", type=int, default=20)
    parser.add_argument("--batches", type=int, default=1)
    parser.add_argument("--seed", type=int, default=7000)
    parser.add_argument("--of-batch", default="")
    parser.add_argument("--recipe", action="append")
    options = parser.parse_args()
    names = options.recipe or ["adaptive", "adaptive-batch"]
    tested: dict[str, list[Tested]] = {name: [] for name in names}
    for number in range(options.batches):
        batch, first = f"B{options.seed}-{number}", options.seed + 1000 * number
        kept = learn_model(batch, options.rho, options.earlier, first)
        for index in range(options.sensors):
            for name in names:
                one = test_sensor(
                    load_recipe_table(name), first + 500 + index, options.of_batch or batch, options.rho, kept
                )
                tested[name].append(one)
                sys.stdout.write(f"{batch} {index} {name}: {one}\n")
                sys.stdout.flush()
    sys.stdout.write(
        "| recipe | presses | minutes | error [N] | in 68 % | in 95 % | unlike |\n|" + " --- |" * 7 + "\n"
    )
    for name, of_recipe in tested.items():
        sys.stdout.write(describe(name, of_recipe))


if __name__ == "__main__":
    main()
