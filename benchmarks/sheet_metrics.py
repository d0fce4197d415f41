"""What the metrics of a run say on simulated sheets: the figures of docs/explanation/metrics.md.

``python -m benchmarks.sheet_metrics`` prints all of them (three minutes); with names of parts, those alone.
Seeds stand beside each figure.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.characterisation import strip
from benchmarks.kept_runs import RECIPE, Figures, measured, shipped_phases, simulated
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.run import RunRecord

NINE = "nine locations"
#: Relative noise that counts as negligible.
_QUIET = 1e-7
#: Scene → seeds that relaxations are compared on.
_SCENES = {"base": range(1, 5), "everything": range(1, 3)}
_HEAD = ("| scene | after | shape difference | equivalent | time ratio | equivalent |", "|" + " --- |" * 6)
_LOOP = {
    "name": "hysteresis",
    "sequence": "hysteresis-loop",
    "strains_percent": [7.5, 15.0, 22.5, 30.0],
    "cycles": 3,
    "hold_s": 60.0,
    "rest_s": 120.0,
}


def weighting() -> Iterator[str]:
    """Equal and measured weights, on a sound sensor and on one with a noisy electrode."""
    (nine,) = shipped_phases(NINE)
    phases = [{**nine, "strains_percent": [5.0, 20.0]}]
    noisy = {"name": "electrode-noise", "electrode": 5, "relative_noise": 2.4e-3}  # 3.2 times the material's in all
    yield "| noise, seeds 1 to 8 | E_CoM equal → measured | A_OL | noise floor | loads of 72 not seen at 5 % strain |"
    yield "|" + " --- |" * 5
    for what, effects in (("the same on all readings", []), ("3.2 times as much on one electrode", [noisy])):
        runs = [simulated(phases, seed, effects=effects) for seed in range(1, 9)]
        equal, weighed = (_localised(runs, weights) for weights in ("equal", "measured"))
        cells = (f"{one} → {other}" for one, other in zip(equal, weighed, strict=True))
        yield f"| {what} | {' | '.join(cells)} |"


def _localised(runs: Sequence[RunRecord], weights: Any) -> list[str]:
    settings = replace(load_recipe(RECIPE).value.analysis, noise_weighting=weights)
    names = ("centre-of-mass-error", "area-overlap", "image-noise")
    seen = [measured(run, *names, settings=settings, over_time=False) for run in runs]
    error, overlap = (_by_strain(seen, name) for name in ("centre_of_mass_error", "area_overlap"))
    floor = np.mean([run.one("noise_floor").value for run in seen])
    missed = sum(value is None for value in error[0.05])
    return [_mean(error[0.2], 2, " mm"), _mean(overlap[0.2], 1, " %"), f"{floor:.4f}", f"{missed}"]


def _by_strain(seen: Sequence[Figures], name: str) -> dict[float, list[float | None]]:
    every = [one for run in seen for one in run.every(name)]
    return {strain: [one.value for one in every if one.strain == strain] for strain in (0.05, 0.2)}


def _mean(values: Sequence[float | None], digits: int, unit: str) -> str:
    return f"{np.mean([value for value in values if value is not None]):.{digits}f}{unit}"


def settling() -> Iterator[str]:
    """Settling times after a press, of single loads and of one fit to all."""
    yield "| loads, seeds 1 to 6 | `mean_settling_time` | `common_settling_time` | its stated error |"
    yield "|" + " --- |" * 4
    for what, phases in (
        ("23, the shipped recipe", shipped_phases()),
        ("nine locations alone", shipped_phases(NINE)),
    ):
        seen = [measured(simulated(phases, seed), "settling-time") for seed in range(1, 7)]
        alone, common = (
            [run.one(f"{name}_settling_time", "conductance, loading") for run in seen] for name in ("mean", "common")
        )
        yield f"| {what} | {_spread(alone)} s | {_spread(common)} s | {_stated(common)} s |"


def _spread(each: Sequence[Measurement]) -> str:
    values = [_told(one) for one in each]
    return f"{np.mean(values):.1f} ± {np.std(values, ddof=1):.1f}"


def _stated(each: Sequence[Measurement]) -> str:
    errors = [one.uncertainty or 0.0 for one in each]
    return f"{min(errors):.1f} to {max(errors):.1f}"


def _told(one: Measurement) -> float:
    if one.value is None:
        raise SystemExit(f"{one.name} has no value: {one.how}")
    return one.value


def agreement() -> Iterator[str]:
    """Whole image against blobs, nine locations of 20 % strain."""
    yield from _HEAD
    for scene, seeds in _SCENES.items():
        runs = [simulated(shipped_phases(NINE), seed, scene=scene) for seed in seeds]
        seen = [measured(run, "relaxation-agreement") for run in runs]
        for direction in ("loading", "unloading"):
            qualifier = f"image against conductance, {direction}"
            names = {"relaxation_shape_difference": None, "relaxation_time_ratio": None}
            yield _compared(scene, direction, seen, names, qualifier)


def against_strip() -> Iterator[str]:
    """A sheet against a strip of nine cycles of its material."""
    yield from _HEAD
    difference, ratio = "strip_relaxation_difference", "strip_relaxation_time_ratio"
    for scene, seeds in _SCENES.items():
        seen = []
        for seed in seeds:
            run = simulated(shipped_phases(NINE), seed, scene=scene)
            relaxation = strip("cbsr-8wt", seed, (0.2,), 9, 0.0).relaxation
            material = replace(run.material, strip_relaxation=relaxation)
            seen.append(measured(replace(run, material=material), "relaxation-against-strip"))
        for direction in ("loading", "unloading"):
            names = {difference: "strip_relaxation_difference_bound", ratio: "strip_relaxation_time_bound"}
            yield _compared(scene, direction, seen, names, direction)


def _compared(
    scene: str, direction: str, seen: Sequence[Figures], names: Mapping[str, str | None], qualifier: str
) -> str:
    cells = [f"`{scene}`", "press" if direction == "loading" else "release"]
    for name, bound in names.items():
        values = [
            _value(run, name, qualifier) + (f" ({_value(run, bound, qualifier)})" if bound else "") for run in seen
        ]
        equivalent = sum(run.one(name, qualifier).how.startswith("equivalent") for run in seen)
        cells += [", ".join(values), f"{equivalent} of {len(seen)}"]
    return f"| {' | '.join(cells)} |"


def _value(run: Figures, name: str, qualifier: str) -> str:
    value = run.one(name, qualifier).value
    return "none" if value is None else f"{value:.2f}".replace("-", "−")


def creep() -> Iterator[str]:
    """Creep of the conductance, of the stress, and of the one without the other."""
    seen = [measured(simulated(shipped_phases(NINE), seed), "creep") for seed in range(1, 5)]
    for qualifier in ("conductance", "stress", ""):
        found = [run.one("creep", qualifier) for run in seen]
        yield f"creep {qualifier or 'alone'}, seeds 1 to 4: {_spread(found)} %"


def uniformity() -> Iterator[str]:
    """Spread over the thirty places of an even sheet, with the usual noise and with next to none."""
    places = shipped_phases("calibration places", recipe="campaign")
    for what, noise in (("usual noise", None), ("next to no noise", _QUIET)):
        seen = measured(simulated(places, 1, noise=noise), "uniformity", over_time=False)
        for qualifier in ("", "baseline conductance"):
            one = seen.one("uniformity", qualifier)
            yield f"{what}, seed 1, {qualifier or 'response'}: {_told(one):.1f} % ({one.how})"


def hysteresis() -> Iterator[str]:
    """Loops at the centre to 30 % strain: known widths without noise, then none under the usual noise."""
    quiet: dict[str, list[dict[str, Any]]] = {
        "no hysteresis": [],
        "loop of 4 %": [{"name": "hysteresis", "width": 0.04}],
        "loop of 10 %": [{"name": "hysteresis", "width": 0.1}],
        "residue of 5 % that fades in 600 s": [{"name": "residue", "share": 0.05, "decay_s": 600.0}],
        "play of the head of 0.04 mm": [{"name": "backlash", "play_mm": 0.04, "depth_play_mm": 0.04}],
        "spike of 10 % at each unloading": [{"name": "unloading-spike", "size": 0.1, "decay_s": 3.0}],
    }
    yield "| sheet | seeds | found [% of span] | stated error | as read |"
    yield "|" + " --- |" * 5
    for what, effects in quiet.items():
        runs = [measured(simulated([_LOOP], 1, effects=effects, noise=_QUIET), "hysteresis", over_time=False)]
        yield f"| {what}, without noise | 1 | {_loops(runs)} |"
    runs = [measured(simulated([_LOOP], seed), "hysteresis", over_time=False) for seed in range(1, 13)]
    yield f"| no hysteresis, usual noise | 1 to 12 | {_loops(runs)} |"


def _loops(runs: Sequence[Figures]) -> str:
    found, read = ([run.one("hysteresis", qualifier) for run in runs] for qualifier in ("", "as read"))
    if len(runs) > 1:
        return f"{_spread(found)} | {_stated(found)} | {_spread(read)}"
    return f"{_told(found[0]):.1f} | {found[0].uncertainty:.1f} | {_told(read[0]):.1f}"


PARTS: dict[str, Callable[[], Iterator[str]]] = {
    part.__name__: part for part in (weighting, settling, agreement, against_strip, creep, uniformity, hysteresis)
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sheet_metrics", description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], metavar=f"{{{','.join(PARTS)}}}")
    for name in parser.parse_args().parts or PARTS:
        print(f"== {name}", flush=True)
        for line in PARTS[name]():
            print(line, flush=True)


if __name__ == "__main__":
    main()
