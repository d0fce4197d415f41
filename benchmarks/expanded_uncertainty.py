"""How often expanded uncertainties hold the truth, which is drawn from what the standards and the calibration state.

``python -m benchmarks.expanded_uncertainty`` draws 400 sensors with 30 loads each, in every setting, and prints the
table of docs/explanation/uncertainty.md, in half an hour of one core. A sensor's load cell, stage, source
meter and temperature are drawn once, as are its response and the estimate of its scatter. Frames are those of the
templates at the true place, and go through the runtime's inversion: the budget's own linear model is not used. Each
load is told on the day of calibration, where the load cell reads it too, and again in use.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "samples"))

from force_calibration import force_calibration

from benchmarks.uncertainty_rates import Told, compare_conformance, hold_rates, mean_shares, normalised_variance
from cbsr_qa.calibration.force.inverse import ForceInverse, Forces, map_tables
from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.calibration.sheet.response_processes import compute_covariance
from cbsr_qa.calibration.uncertainty.budget import ReferencePress, evaluate_errors, expand_forces
from cbsr_qa.calibration.uncertainty.places import evaluate_places
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.results.calibration import BaselineConductance, Calibration
from cbsr_qa.domain.sensor.sensor_type import Parameter

_FORCES_N: Final = (1.0, 5.5)
_RADIUS_MM: Final = 28.0
_PRESSES: Final = 3
_DATES: Final = ("Lab", "2026-01-01", "2027-01-01")
#: Smallest share of the variance of a component whose absence must show.
_SHOWS: Final = 0.1
#: Samples of the load cell during a frame, and their standard deviation [N].
_SAMPLES: Final = 8
_SAMPLE_N: Final = 0.02


@dataclass(frozen=True)
class Setting:
    """What a kind of calibration states: U of each standard (k = 2), and standard errors of its model.

    Parameters
    ----------
    load_cell_percent, drift_percent, stage_mm, gain_percent : U of the load cell, its largest drift a year, U of the
        stage, largest drift of the gains a year.
    per_C : relative change of the force by a degree; the range of temperatures is 4 °C.
    map_stderr, scatter : standard error of ln S, and scatter of loads.
    places : number of places that were pressed, three times each.
    noise : factor on the readings' noise.
    """

    load_cell_percent: float = 1.5
    drift_percent: float = 0.5
    stage_mm: float = 0.4
    gain_percent: float = 0.01
    per_C: float = 0.006
    map_stderr: float = 0.025
    scatter: float = 0.02
    places: int = 9
    noise: float = 0.5


SETTINGS: Final = {
    "usual": Setting(),
    "a coarse load cell": Setting(load_cell_percent=8.0, drift_percent=1.0),
    "a load cell that drifts": Setting(drift_percent=6.0, map_stderr=0.02, scatter=0.015),
    "a coarse stage": Setting(stage_mm=2.0, map_stderr=0.015, scatter=0.01, noise=0.3),
    "gains that drift": Setting(gain_percent=0.05),
    "a warm room": Setting(per_C=0.03),
    "a map of few places": Setting(map_stderr=0.12),
    "loads that scatter, four repeats": Setting(scatter=0.08, places=2),
}


def make_calibration(setting: Setting) -> Calibration:
    """Return the calibration of a setting; its model is that of one sensor, learned from exact readings."""
    sample = force_calibration()
    if sample.force is None:
        raise SystemExit("the sample has no force model")
    model = replace(
        sample.force,
        merging=sample.force.merging / setting.noise,
        log_size=sample.force.log_size - np.log(setting.noise),
        log_response_stderr=np.full_like(sample.force.log_response_stderr, setting.map_stderr),
        scatter=setting.scatter,
        place_scatter_mm=0.3,
        residue_strength=2e-4,
    )
    standards = (
        ReferenceStandard(
            "load_cell", "K", *_DATES, setting.load_cell_percent, 2.0, "%", setting.drift_percent, 0.01
        ),
        ReferenceStandard("stage", "S", *_DATES, setting.stage_mm, 2.0, "mm"),
        ReferenceStandard("thermometer", "T", *_DATES, 0.4, 2.0, "°C"),
        ReferenceStandard("source_meter", "Q", *_DATES, 0.1, 2.0, "%", setting.gain_percent),
    )
    baseline = tuple(BaselineConductance(f"L{n}", 0.0, 0.0, 0.3, 0.01, _PRESSES) for n in range(setting.places))
    return replace(
        sample,
        force=model,
        standards=standards,
        baseline=baseline,
        response_per_C=Parameter(setting.per_C, 0.0, "the setting"),
        validity=replace(sample.validity, temperature_C=(20.0, 24.0), force_N=(0.5, 7.0)),
    )


def simulate_sensor(issued: Calibration, seed: int, loads: int) -> Told:
    """Draw one sensor's truth and tell its loads as the runtime does."""
    random = np.random.default_rng([2026, seed])
    model, line = issued.force, issued.against_stress
    if model is None or issued.response_per_C is None:
        raise SystemExit("a setting lacks its model")
    load_cell, stage, thermometer, meter = issued.standards
    angle, radius_mm = random.uniform(0, 2 * np.pi, loads), _RADIUS_MM * np.sqrt(random.uniform(0, 1, loads))
    stated_mm = np.column_stack([radius_mm * np.cos(angle), radius_mm * np.sin(angle)])
    true_N = random.uniform(*_FORCES_N, loads)
    matched = TemplateFilter(model)
    tables = map_tables(model)
    inverse = ForceInverse(model, line, issued.indenter.area_mm2, tables)

    # the sheet: response that the map missed, and scatter that the calibration estimated from its repeats
    freedom = max(sum(place.loads - 1 for place in issued.baseline), 1)
    scatter = model.scatter / np.sqrt(random.chisquare(freedom) / freedom)
    correlation = compute_covariance(stated_mm, stated_mm, 20.0, True) + 1e-6 * np.eye(loads)
    stderr = float(model.log_response_stderr[0])
    missed = stderr * np.linalg.cholesky(correlation) @ random.standard_normal(loads)
    scattered = missed + scatter * random.standard_normal(loads)
    # the line turns about the stress in the middle, as it was fitted
    turned = random.standard_normal()
    slope = line.slope.value + np.sign(line.covariance or 1.0) * (line.slope.stderr or 0.0) * turned
    intercept = line.intercept.value + (line.intercept.stderr or 0.0) * turned
    stress_kPa = true_N / issued.indenter.area_mm2 * 1e3

    # presses, displaced by the stage; the frame is that of the true place
    offset_mm = stage.standard_uncertainty * random.standard_normal(2)
    pressed_mm = stated_mm + offset_mm

    def rows_of(place_mm: Array, log_missed: Array, residue: Array) -> Array:
        true_map = inverse.strength(true_N, place_mm)
        of_map = 2 * true_map / (2 - true_map)
        change = of_map * (slope * stress_kPa + intercept) / (line.slope.value * stress_kPa + line.intercept.value)
        contrast = change * np.exp(log_missed)
        strength = 2 * contrast / (2 + contrast) + residue
        return strength[:, None] * matched.template(place_mm)

    left = np.hypot(model.residue_share, model.residue_stderr) * model.residue_strength
    gain = _draw_rectangle(random, meter.drift_uncertainty(1.0) or 0.0)
    rows = rows_of(pressed_mm, scattered, left * random.standard_normal(loads))
    day_rows = rows + random.standard_normal(rows.shape)
    rows = day_rows + gain * (model.merging @ issued.reference[issued.reconstruction.problem.used])

    # told as the runtime does, with newtons of the load cell; in use at another temperature
    years = 324 / 365.25
    of_cell = load_cell.standard_uncertainty * random.standard_normal()
    of_cell += _draw_rectangle(random, load_cell.drift_uncertainty(years) or 0.0)
    step_N = (load_cell.resolution or 0.0) / np.sqrt(12)
    added_N = _draw_rectangle(random, step_N)
    warmth_C = _draw_rectangle(random, 4 / np.sqrt(12)) + thermometer.standard_uncertainty * random.standard_normal()

    def tell(rows: Array, factor: float) -> Array:
        return inverse.force(matched.match_at(rows, stated_mm))[0] * (1 + factor) + added_N

    told_N, day_N = tell(rows, of_cell + issued.response_per_C.value * warmth_C), tell(day_rows, of_cell)
    # the sensor's own error is that of loads exactly there, over all scatter and noise
    own_error_N = tell(rows_of(stated_mm, missed, np.zeros(loads)), of_cell) - true_N

    read_N = true_N * (1 + of_cell) + _draw_rectangle(random, step_N)
    presses = _read_presses(random, read_N, stated_mm, model.steady_s)
    nothing = np.zeros(loads)
    forces = Forces(told_N, nothing, stated_mm, nothing, nothing, nothing.astype(np.int64), nothing)
    # places in the stage's millimetres: the sheet lies where the stage's readings say
    found_mm = matched.search(rows).place_mm + model.place_scatter_mm * random.standard_normal((loads, 2)) + offset_mm
    return Told(
        tuple(one for one in expand_forces(issued, forces) if one is not None),
        told_N - true_N,
        day_N - true_N,
        evaluate_errors(issued, presses),
        day_N - np.array([press.force_N for press in presses]),
        own_error_N,
        random.uniform(0.1, 2.5, loads) * np.hypot(stderr, load_cell.standard_uncertainty) * true_N,
        np.hypot(*(found_mm - pressed_mm).T),
        _expand_places(issued, true_N, pressed_mm),
        correlation,
    )


def _read_presses(
    random: np.random.Generator, force_N: Array, stated_mm: Array, settling_s: float
) -> list[ReferencePress]:
    """Draw what the load cell reads during the frame of each press."""
    samples_N = force_N[:, None] + _SAMPLE_N * random.standard_normal((len(force_N), _SAMPLES))
    stderr_N = samples_N.std(axis=1, ddof=1) / np.sqrt(_SAMPLES)
    read = np.column_stack([stated_mm, samples_N.mean(axis=1), stderr_N]).tolist()
    return [
        ReferencePress((x_mm, y_mm), settling_s, mean_N, error_N, _SAMPLES, steady_N=mean_N)
        for x_mm, y_mm, mean_N, error_N in read
    ]


def _expand_places(issued: Calibration, force_N: Array, place_mm: Array) -> Array:
    """Return the stated radii (n,) of places [mm]."""
    loads = zip(force_N.tolist(), place_mm.tolist(), strict=True)
    return np.array([evaluate_places(issued, [force], [(x_mm, y_mm)])[0].U_mm for force, (x_mm, y_mm) in loads])


def _draw_rectangle(random: np.random.Generator, standard_uncertainty: float) -> float:
    return float(random.uniform(-1, 1)) * standard_uncertainty * np.sqrt(3)


def describe_setting(name: str, told: Sequence[Told]) -> list[str]:
    """Lines of one setting: what is held, and what leaving out a component does."""
    rates = hold_rates(told)
    mean, _ = normalised_variance(told)
    held = ", ".join(f"{what} {100 * rate:.1f} ± {100 * stderr:.1f} %" for what, (rate, stderr) in rates.items())
    lines = [f"{name}: held {held}; normalised variance {mean:.3f}"]
    for stated, share, stderr, count in compare_conformance(told):
        lines.append(f"    conformance {stated:.3f} stated, {share:.3f} ± {stderr:.3f} of {count} loads conform")
    for part, share in sorted(mean_shares(told).items(), key=lambda item: -item[1]):
        without, p_value = normalised_variance(told, part)
        shows = f"p = {p_value:.1g}" if share >= _SHOWS else f"U × {np.sqrt(max(1 - share, 0)):.4f} without it"
        lines.append(f"    {part}: {100 * share:.1f} % of the variance; without it {without:.3f}, {shows}")
    return lines


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sensors", type=int, default=400)
    parser.add_argument("--loads", type=int, default=30)
    parser.add_argument("--settings", nargs="*", default=list(SETTINGS))
    given = parser.parse_args()
    for name in given.settings:
        issued = make_calibration(SETTINGS[name])
        told = [simulate_sensor(issued, seed, given.loads) for seed in range(given.sensors)]
        print("\n".join(describe_setting(name, told)), flush=True)


if __name__ == "__main__":
    main()
