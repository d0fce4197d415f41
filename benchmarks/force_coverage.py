"""How honest the errors of forces are: held-out loads on simulated sensors, many enough to count intervals.

``python -m benchmarks.force_coverage --sensors 8wt --seeds 9000:9018`` simulates a sensor a seed (20 s each), learns
its force from the nine locations and from 39 places, tests both on thirty random loads, and adds what came out to a
file (``--to``), from which the table of all that is in it is printed. Seeds that are there already are not simulated
again.
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
from cbsr_qa.analysis.run import (
    HELD_OUT,
    TRIAL_LEFT_OUT,
    ForceErrors,
    ForceTest,
    RunForce,
    errors_of,
    global_errors,
    run_force,
    tests_of,
)
from cbsr_qa.calibration.runtime import interpolated
from cbsr_qa.calibration.sheet import sheet_places

Array = NDArray[np.float64]
#: Errors and their stated standard errors of one test of one sensor [N].
Errors = dict[str, list[float]]
Result = dict[str, Any]

#: Calibration → the phases it is learned from.
CALIBRATIONS = {"nine": (NINE,), "39": (NINE, PLACES)}
_REACH = {68: 1.0, 95: 1.959964}
_RADIUS_MM = 40.0
_COLUMNS = (
    "sensors",
    "calibration",
    "test",
    "loads",
    "σ_F [N]",
    "bias [N]",
    "over one response",
    "68 % hold [%]",
    "95 % hold [%]",
    "map: error, stated",
)


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
        result |= _errors("trial left out, ", repeated)
    return result | {"map": _map_error(seen, found)}


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
    error = interpolated(model, model.log_response, places) - np.log(seen.response(places))
    stated = interpolated(model, model.log_response_stderr, places)
    return {"error_N": [float(error.std())], "stderr_N": [float(np.sqrt((stated**2).mean()))]}


def table(results: Mapping[str, Mapping[str, Result]]) -> Iterator[str]:
    """Lines of a table in Markdown."""
    yield f"| {' | '.join(_COLUMNS)} |"
    yield "|" + " --- |" * len(_COLUMNS)
    for name, sensors in SENSORS.items():
        seeds = list(results.get(name, {}).values())
        for calibration in CALIBRATIONS:
            for test in sorted({test for seed in seeds for test in seed[calibration]} - {"map", "one response"}):
                each = [seed[calibration] for seed in seeds]
                what = f"{len(seeds)} × {sensors.title}"
                yield f"| {what} | {calibration} | {test} | {_row(each, test)} |"


def _row(each: Sequence[Result], test: str) -> str:
    errors, stated = ([np.array(one[test][key]) for one in each] for key in ("error_N", "stderr_N"))
    together = np.concatenate(errors)
    own = [one.std(ddof=1) for one in errors]
    whole = np.concatenate([np.array(one["one response"]["error_N"]) for one in each])
    ratio = "" if test.startswith("trial") else f"{together.std(ddof=1) / whole.std(ddof=1):.2f}"
    shares = [_share(errors, stated, reach) for reach in _REACH.values()]
    maps = [np.sqrt(np.mean([one["map"][key][0] ** 2 for one in each])) for key in ("error_N", "stderr_N")]
    cells = (
        f"{len(together)}",
        f"{together.std(ddof=1):.3f} ({min(own):.2f} to {max(own):.2f})",
        f"{together.mean():+.3f}",
        ratio,
        *shares,
        " %, ".join(f"{100 * size:.1f}" for size in maps) + " %",
    )
    return " | ".join(cells)


def _share(errors: Sequence[Array], stated: Sequence[Array], reach: float) -> str:
    """Share of loads within so many stated errors, ± by how much sensors differ: loads of one share its map."""
    inside = [np.abs(error) <= reach * size for error, size in zip(errors, stated, strict=True)]
    all_loads = np.concatenate(inside)
    sensors = np.array([one.mean() for one in inside])
    chance = sensors.std(ddof=1) / len(sensors) ** 0.5 if len(sensors) > 1 else math.nan
    return f"{100 * all_loads.mean():.1f} ± {100 * chance:.1f}"


def add(results: dict[str, dict[str, Result]], name: str, seed: int, to: Path) -> None:
    """Simulate one sensor if it is not there yet, and write the file again."""
    of_kind = results.setdefault(name, {})
    if str(seed) not in of_kind:
        of_kind[str(seed)] = result_of(observed(SENSORS[name], seed))
        to.write_text(json.dumps(results))


def main() -> None:
    """Simulate what is asked for, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.force_coverage", description=__doc__)
    parser.add_argument("--sensors", choices=SENSORS, default="8wt")
    parser.add_argument("--seeds", default="0:0", help="first and one after the last, as 9000:9018")
    parser.add_argument("--to", type=Path, default=Path("build/force-coverage.json"))
    chosen = parser.parse_args()
    chosen.to.parent.mkdir(parents=True, exist_ok=True)
    results = json.loads(chosen.to.read_text()) if chosen.to.exists() else {}
    for seed in range(*map(int, chosen.seeds.split(":"))):
        add(results, chosen.sensors, seed, chosen.to)
        print(f"{chosen.sensors}, seed {seed}", flush=True)
    print("\n".join(table(results)))


if __name__ == "__main__":
    main()
