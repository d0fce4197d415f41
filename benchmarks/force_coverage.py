"""How honest the errors of forces are: held-out loads on simulated sensors, many enough to count intervals.

``python -m benchmarks.force_coverage`` prints the table of docs/explanation/force.md. It simulates a sensor a seed
(12 s each, a quarter of an hour in all), learns its force from the nine locations and from 39 places, tests both on
thirty random loads, and adds the results to a file (``--to``), from which the table is printed. Seeds that are in the
file are not simulated again. ``--sensors short`` prints one kind alone.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.force_sensors import NINE, PLACES, RANDOM, SENSORS, Observed, observed
from cbsr_qa.analysis.run.force import HELD_OUT, TRIAL_LEFT_OUT, ForceTest, RunForce, run_force
from cbsr_qa.analysis.run.force_quality import ForceErrors, detectable_forces, errors_of, global_errors, tests_of
from cbsr_qa.calibration.force.interpolation import interpolate
from cbsr_qa.calibration.sheet.response_map import sheet_places

Array = NDArray[np.float64]
#: Errors and their stated standard errors of one test of one sensor [N].
Errors = dict[str, list[float]]
Result = dict[str, Any]

#: Calibration → the phases it is learned from.
CALIBRATIONS = {"nine": (NINE,), "39": (NINE, PLACES)}
_REACH = {68: 1.0, 95: 1.959964}
_RADIUS_MM = 40.0
_FIRST_SEED = 9000
_COLUMNS = (
    "sensors",
    "calibration",
    "loads",
    "σ_F, place known",
    "bias",
    "held [%]",
    "σ_F, place estimated",
    "bias",
    "held [%]",
    "one response",
    "map: error, stated",
)
_LEFT_OUT = "trial left out, "


def result_of(seen: Observed) -> Result:
    """Learn and test one sensor each way: calibration → test → errors, and the error of the map."""
    return {name: _calibrated(seen, phases) for name, phases in CALIBRATIONS.items()}


def _calibrated(seen: Observed, phases: tuple[str, ...]) -> Result:
    run = replace(seen.run, settings=replace(seen.run.settings, calibrate_phases=phases))
    found = run_force(run)
    if found.learned is None:
        raise SystemExit(f"nothing was learned: {found.why}")
    random = [test for test in found.tests if test.how == HELD_OUT and test.load.phase == RANDOM]
    result: Result = {**_errors("", random), "one response": _listed(global_errors(random))}
    repeated = tests_of(run, found, TRIAL_LEFT_OUT)
    if repeated:
        result |= _errors(_LEFT_OUT, repeated)
    (least,) = detectable_forces(found.learned, run.record.indenter, np.zeros((1, 2)))
    return result | {
        "map": _map_error(seen, found),
        "rotation_deg": found.sheet_pose.rotation_deg,
        "least_force_N": least.force_N,
    }


def _errors(what: str, tests: Sequence[ForceTest]) -> Result:
    both = {"place known": errors_of(tests, known=True), "place estimated": errors_of(tests, known=False)}
    return {what + name: _listed(errors) for name, errors in both.items()}


def _listed(errors: ForceErrors) -> Errors:
    known = [error if math.isfinite(error) else 0.0 for error in errors.stderr_N.tolist()]
    return {"error_N": errors.error_N.tolist(), "stderr_N": known}


def _map_error(seen: Observed, found: RunForce) -> Errors:
    """Relative error of the map in shape, and what is stated of it, root mean squares within 40 mm."""
    assert found.learned is not None
    model = found.learned.model
    places = sheet_places(model, stride=2)
    places = places[np.hypot(*places.T) <= _RADIUS_MM]
    error = interpolate(model, model.log_response, places) - np.log(seen.response(places))
    stated = interpolate(model, model.log_response_stderr, places)
    return {"error_N": [float(error.std())], "stderr_N": [float(np.sqrt((stated**2).mean()))]}


def table(results: Mapping[str, Mapping[str, Result]]) -> Iterator[str]:
    """Lines of a table in Markdown, then remarks on each kind of sensor."""
    yield f"| {' | '.join(_COLUMNS)} |"
    yield "|" + " --- |" * len(_COLUMNS)
    kinds = [(kind, list(results[name].values())) for name, kind in SENSORS.items() if results.get(name)]
    for kind, sensors in kinds:
        for calibration in CALIBRATIONS:
            each = [sensor[calibration] for sensor in sensors]
            for test in ("", _LEFT_OUT):
                if f"{test}place known" in each[0]:
                    yield f"| {len(each)} × {kind.title} | {test}{calibration} | {_row(each, test)} |"
    for kind, sensors in kinds:
        told = {name: [sensor["39"][name] for sensor in sensors] for name in ("rotation_deg", "least_force_N")}
        yield f"{kind.title}: {', '.join(f'{name} {_spread(values)}' for name, values in told.items())}"


def _spread(values: Sequence[float]) -> str:
    return f"{np.mean(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def _row(each: Sequence[Result], test: str) -> str:
    cells = [f"{sum(len(one[test + 'place known']['error_N']) for one in each)}"]
    for place in ("place known", "place estimated"):
        errors, stated = ([np.array(one[test + place][key]) for one in each] for key in ("error_N", "stderr_N"))
        together = np.concatenate(errors)
        own = [one.std(ddof=1) for one in errors]
        spread = f" ({min(own):.2f} to {max(own):.2f})" if place == "place known" else ""
        shares = ", ".join(_share(errors, stated, reach) for reach in _REACH.values())
        cells += [f"{together.std(ddof=1):.3f}{spread}", f"{together.mean():+.3f}".replace("-", "−"), shares]
    whole = np.concatenate([np.array(one["one response"]["error_N"]) for one in each])
    maps = [np.sqrt(np.mean([one["map"][key][0] ** 2 for one in each])) for key in ("error_N", "stderr_N")]
    cells += ["" if test else f"{whole.std(ddof=1):.3f}", ", ".join(f"{100 * size:.1f}" for size in maps) + " %"]
    return " | ".join(cells)


def _share(errors: Sequence[Array], stated: Sequence[Array], reach: float) -> str:
    """Share of loads within so many stated errors, ± by how much sensors differ: loads of one share its map."""
    inside = [np.abs(error) <= reach * size for error, size in zip(errors, stated, strict=True)]
    all_loads = np.concatenate(inside)
    sensors = np.array([one.mean() for one in inside])
    chance = sensors.std(ddof=1) / len(sensors) ** 0.5 if len(sensors) > 1 else math.nan
    return f"{100 * all_loads.mean():.0f} ± {100 * chance:.0f}"


def add(results: dict[str, dict[str, Result]], name: str, seed: int, to: Path) -> None:
    """Simulate one sensor if it is not there yet, and write the file again."""
    of_kind = results.setdefault(name, {})
    if str(seed) not in of_kind:
        of_kind[str(seed)] = result_of(observed(SENSORS[name], seed))
        to.write_text(json.dumps(results))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.force_coverage", description=__doc__)
    parser.add_argument("--sensors", choices=SENSORS, action="append", help="by default all kinds")
    parser.add_argument("--seeds", help="first and one after the last, as 9000:9018; by default those of the table")
    parser.add_argument("--to", type=Path, default=Path("build/force-coverage.json"))
    chosen = parser.parse_args()
    chosen.to.parent.mkdir(parents=True, exist_ok=True)
    results = json.loads(chosen.to.read_text()) if chosen.to.exists() else {}
    for name in chosen.sensors or SENSORS:
        seeds = chosen.seeds or f"{_FIRST_SEED}:{_FIRST_SEED + SENSORS[name].count}"
        for seed in range(*map(int, seeds.split(":"))):
            add(results, name, seed, chosen.to)
            print(f"{name}, seed {seed}", flush=True)
    print("\n".join(table(results)))


if __name__ == "__main__":
    main()
