"""How often expanded uncertainties hold the truth, which is drawn from what the standards and the calibration state.

``python -m benchmarks.expanded_uncertainty`` draws 400 sensors with 30 loads each, in every setting, and prints the
table of docs/explanation/uncertainty.md, in twenty minutes of one core. A sensor's load cell, stage, source
meter and temperature are drawn once, as are its response and the estimate of its scatter. Frames are those of the
templates at the true place, and go through the runtime's inversion: the budget's own linear model is not used.
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
from scipy.stats import t as student_t

from cbsr_qa.calibration.force.inverse import ForceInverse, Forces, map_tables
from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.calibration.sheet.response_processes import compute_covariance
from cbsr_qa.calibration.uncertainty.budget import expand_forces
from cbsr_qa.calibration.uncertainty.places import evaluate_places
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.results.calibration import BaselineConductance, Calibration
from cbsr_qa.domain.results.expanded_force import ExpandedForce
from cbsr_qa.domain.sensor.sensor_type import Parameter

_FORCES_N: Final = (1.0, 5.5)
_RADIUS_MM: Final = 28.0
_PRESSES: Final = 3
_DATES: Final = ("Lab", "2026-01-01", "2027-01-01")
_MAP: Final = "map between places"
#: Smallest share of the variance of a component whose absence must show.
_SHOWS: Final = 0.1


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
        validity=replace(sample.validity, temperature_C=(20.0, 24.0)),
    )


@dataclass(frozen=True)
class Told:
    """What one sensor told of its loads, and the truth.

    Parameters
    ----------
    expanded : uncertainty of each force at the stated place.
    error_N : (n,) told less true forces.
    place_error_mm, place_U_mm : (n,) distances of told from true places, and stated radii.
    map_correlation : (n, n) correlation of the map's errors at the places of the loads.
    """

    expanded: tuple[ExpandedForce, ...]
    error_N: Array
    place_error_mm: Array
    place_U_mm: Array
    map_correlation: Array


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
    missed += scatter * random.standard_normal(loads)
    # the line turns about the stress in the middle, as it was fitted
    turned = random.standard_normal()
    slope = line.slope.value + np.sign(line.covariance or 1.0) * (line.slope.stderr or 0.0) * turned
    intercept = line.intercept.value + (line.intercept.stderr or 0.0) * turned
    stress_kPa = true_N / issued.indenter.area_mm2 * 1e3

    # presses, displaced by the stage; the frame is that of the true place
    offset_mm = stage.standard_uncertainty * random.standard_normal(2)
    pressed_mm = stated_mm + offset_mm
    true_map = inverse.strength(true_N, pressed_mm)
    of_map = 2 * true_map / (2 - true_map)
    change = of_map * (slope * stress_kPa + intercept) / (line.slope.value * stress_kPa + line.intercept.value)
    contrast = change * np.exp(missed)
    strength = 2 * contrast / (2 + contrast)
    left = np.hypot(model.residue_share, model.residue_stderr) * model.residue_strength
    strength += left * random.standard_normal(loads)
    gain = _draw_rectangle(random, meter.drift_uncertainty(1.0) or 0.0)
    rows = strength[:, None] * matched.template(pressed_mm)
    rows += gain * (model.merging @ issued.reference[issued.reconstruction.problem.used])
    rows += random.standard_normal(rows.shape)

    # told as the runtime does, with newtons of the load cell, at another temperature
    told_N, _ = inverse.force(matched.match_at(rows, stated_mm))
    years = 324 / 365.25
    factor = load_cell.standard_uncertainty * random.standard_normal()
    factor += _draw_rectangle(random, load_cell.drift_uncertainty(years) or 0.0)
    warmth_C = _draw_rectangle(random, 4 / np.sqrt(12)) + thermometer.standard_uncertainty * random.standard_normal()
    factor += issued.response_per_C.value * warmth_C
    told_N = told_N * (1 + factor) + _draw_rectangle(random, (load_cell.resolution or 0.0) / np.sqrt(12))

    nothing, none = np.zeros(loads), np.zeros(loads, dtype=np.int64)
    forces = Forces(told_N, nothing, stated_mm, nothing, nothing, none, nothing)
    expanded = [one for one in expand_forces(issued, forces) if one is not None]
    # places in the stage's millimetres: the sheet lies where the stage's readings say
    found_mm = matched.search(rows).place_mm + model.place_scatter_mm * random.standard_normal((loads, 2)) + offset_mm
    stated_places = [(x_mm, y_mm) for x_mm, y_mm in pressed_mm.tolist()]
    radii_mm = [
        evaluate_places(issued, [force_N], [place_mm])[0].U_mm
        for force_N, place_mm in zip(true_N.tolist(), stated_places, strict=True)
    ]
    place_error_mm = np.hypot(*(found_mm - pressed_mm).T)
    return Told(tuple(expanded), told_N - true_N, place_error_mm, np.array(radii_mm), correlation)


def _draw_rectangle(random: np.random.Generator, standard_uncertainty: float) -> float:
    return float(random.uniform(-1, 1)) * standard_uncertainty * np.sqrt(3)


def hold_rates(told: Sequence[Told]) -> dict[str, tuple[float, float]]:
    """Share of forces and places that U holds, with standard errors by sensors."""
    rates = {"force": [float(np.mean(np.abs(one.error_N) <= [e.U_N for e in one.expanded])) for one in told]}
    rates["place"] = [float(np.mean(one.place_error_mm <= one.place_U_mm)) for one in told]
    return {what: (float(np.mean(by)), float(np.std(by, ddof=1) / np.sqrt(len(by)))) for what, by in rates.items()}


def normalised_variance(told: Sequence[Told], without: str | None = None) -> tuple[float, float]:
    """Mean of eᵀ C⁻¹ e over the loads, C the stated covariance of a sensor's errors e, without a component.

    Returns
    -------
    The mean, 1 if the budget is right, and p of a mean of at most 1. Sensors are independent, their loads are not:
    each sensor is one value of a t-test.
    """
    by_sensor = np.array([_normalise(one, without) for one in told])
    mean, stderr = float(by_sensor.mean()), float(by_sensor.std(ddof=1) / np.sqrt(len(by_sensor)))
    return mean, float(student_t.sf((mean - 1) / stderr, len(by_sensor) - 1))


def _normalise(told: Told, without: str | None) -> float:
    covariance = np.zeros((len(told.error_N), len(told.error_N)))
    for name, dof, is_shared in {(part.name, part.dof, part.shared) for part in told.expanded[0].components}:
        if name == without:
            continue
        by_load = [{part.name: part.contribution for part in expanded.components} for expanded in told.expanded]
        contribution = np.array([contributions[name] for contributions in by_load])
        # an estimate of few degrees of freedom has errors that are distributed as t, whose variance is larger
        contribution = contribution * (1.0 if np.isinf(dof) else np.sqrt(dof / (dof - 2)))
        correlation = np.ones_like(covariance) if is_shared else np.eye(len(covariance))
        correlation = told.map_correlation if name == _MAP else correlation
        covariance += np.outer(contribution, contribution) * correlation
    return float(told.error_N @ np.linalg.solve(covariance, told.error_N)) / len(told.error_N)


def mean_shares(told: Sequence[Told]) -> dict[str, float]:
    """Mean share of the variance of each component, over all loads."""
    names = [part.name for part in told[0].expanded[0].components]
    shares = [{part.name: part.share for part in expanded.components} for one in told for expanded in one.expanded]
    return {name: float(np.mean([share[name] for share in shares])) for name in names}


def describe_setting(name: str, told: Sequence[Told]) -> list[str]:
    """Lines of one setting: what is held, and what leaving out a component does."""
    rates = hold_rates(told)
    mean, _ = normalised_variance(told)
    held = ", ".join(f"{what} {100 * rate:.1f} ± {100 * stderr:.1f} %" for what, (rate, stderr) in rates.items())
    lines = [f"{name}: held {held}; normalised variance {mean:.3f}"]
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
