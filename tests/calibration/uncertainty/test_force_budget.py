"""Budgets of forces: sensitivities are those of the runtime, and what is not stated is said."""

import time
from dataclasses import replace
from math import hypot, inf, sqrt

import numpy as np
import pytest
from force_calibration import force_calibration, frames
from scipy.stats import t as student_t

from cbsr_qa.calibration.abilities import ForceAbility, describe_abilities
from cbsr_qa.calibration.runtime.calibration import Calibration as Runtime
from cbsr_qa.calibration.uncertainty.budget import evaluate_forces
from cbsr_qa.calibration.uncertainty.force_point import Entry, ForcePoints
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.results.calibration import BaselineConductance, BatchUse
from cbsr_qa.domain.results.expanded_force import Result
from cbsr_qa.domain.results.relaxation import RelaxationKernel
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic

LOAD_CELL = ReferenceStandard(
    "load_cell", "K-1", "Lab", "2026-01-01", "2027-01-01", 0.5, 2.0, "%", 0.3, 0.005, 0.5, 20.0
)
STAGE = ReferenceStandard("stage", "S-1", "Lab", "2026-01-01", "2027-01-01", 0.2, 2.0, "mm", 0.1, 0.01)
THERMOMETER = ReferenceStandard("thermometer", "T-1", "Lab", "2026-01-01", "2027-01-01", 0.2, 2.0, "°C", 0.6, 0.5)
SOURCE_METER = ReferenceStandard(
    "source_meter", "Q-1", "Lab", "2026-01-01", "2027-01-01", 0.1, 2.0, "%", 0.02, None, 0.1, 1.0
)
PLACE = (12.5, -7.0)


@pytest.fixture(scope="module")
def bare():
    return force_calibration()


@pytest.fixture(scope="module")
def stated(bare):
    loads = tuple(BaselineConductance(f"L{n}", 3.0 * n, 0.0, 0.3, 0.01, 3) for n in range(9))
    return replace(
        bare,
        standards=(LOAD_CELL, STAGE, THERMOMETER, SOURCE_METER),
        response_per_C=Parameter(0.004, 0.003, "measured"),
        validity=replace(bare.validity, temperature_C=(20.0, 24.0)),
        baseline=loads,
        force=replace(bare.force, scatter=0.02),
    )


def uncertainties(expanded):
    return {part.name: part.standard_uncertainty for part in expanded.components}


def test_without_standards_the_budget_is_what_the_calibration_says_of_itself(bare, stated):
    bare = replace(bare, baseline=stated.baseline)  # enough repeats
    for force_N in (1.0, 4.0):
        ability = ForceAbility.from_calibration(bare, bare.force)
        stderr_N = ability.stderr_N(force_N)
        node = int(np.argmin(np.hypot(*ability.places_mm.T)))
        place_mm = tuple(ability.places_mm[node].tolist())
        (expanded,) = evaluate_forces(bare, [force_N], [place_mm])
        residue_N = uncertainties(expanded)["residue of earlier loads"]
        assert hypot(stderr_N[node], residue_N) == pytest.approx(expanded.standard_uncertainty_N, rel=1e-9)


def test_what_nothing_gives_a_number_for_is_not_in_the_sum(bare, stated):
    (expanded,) = evaluate_forces(bare, [2.0], [PLACE])
    assert expanded.not_stated == (
        "load cell",
        "drift of the load cell",
        "resolution of the load cell",
        "tilt of the head",
        "place of indentation",
        "temperature",
        "drift of gains since the reference",
        "ageing of the sensor",
    )
    (full,) = evaluate_forces(stated, [2.0], [PLACE])
    assert full.not_stated == ("tilt of the head", "ageing of the sensor")
    assert full.standard_uncertainty_N > expanded.standard_uncertainty_N


def test_a_load_cells_certificate_enters_with_drift_since_its_date_and_resolution(stated):
    (expanded,) = evaluate_forces(stated, [2.0], [PLACE])
    parts = uncertainties(expanded)
    years = 324 / 365.25  # from its date to that of the calibration, 2026-11-21
    assert parts["load cell"] == pytest.approx(2 * 0.0025)
    assert parts["drift of the load cell"] == pytest.approx(2 * 0.003 * years / sqrt(3))
    assert parts["resolution of the load cell"] == pytest.approx(0.005 / sqrt(12))
    assert parts["area of the head"] == 0
    temperature_C = hypot(4 / sqrt(12), 0.1, 0.5 / sqrt(12), 0.6 * years / sqrt(3))
    assert parts["temperature"] == pytest.approx(2 * 0.005 * temperature_C)
    assert {part.name for part in expanded.components if part.shared} == {
        "load cell",
        "drift of the load cell",
        "resolution of the load cell",
        "area of the head",
        "place of indentation, x",
        "place of indentation, y",
        "characteristic of the material",
        "temperature",
        "drift of gains since the reference",
    }


@pytest.mark.parametrize("standard", [STAGE, THERMOMETER])
@pytest.mark.parametrize(("key", "name"), [("drift_a_year", "drift"), ("resolution", "resolution")])
def test_what_a_certificate_does_not_state_is_named_and_what_it_states_counts(stated, standard, key, name):
    standard = replace(standard, resolution=0.5)
    silent = replace(standard, **{key: None})
    others = [one for one in stated.standards if one.role != standard.role]
    (less,), (full,) = (
        evaluate_forces(replace(stated, standards=(*others, one)), [2.0], [PLACE]) for one in (silent, standard)
    )
    assert set(less.not_stated) - set(full.not_stated) == {f"{name} of the {standard.role}"}
    assert less.standard_uncertainty_N < full.standard_uncertainty_N


def test_a_drift_of_all_gains_changes_the_force_that_the_runtime_tells_as_much(stated):
    runtime, frame = Runtime(stated), frames([PLACE], np.array([3.0]), noise=0.0)
    force_N = float(runtime.force(frame, place_mm=PLACE).force_N[0])
    drift = 0.0002 / sqrt(3)
    changed_N = float(runtime.force(frame * (1 + drift), place_mm=PLACE).force_N[0]) - force_N
    (expanded,) = evaluate_forces(stated, [force_N], [PLACE])
    # the loads' own change of a few percent grows with them
    assert uncertainties(expanded)["drift of gains since the reference"] == pytest.approx(abs(changed_N), rel=0.05)


def test_a_displaced_load_changes_the_force_that_the_runtime_tells_as_the_budget_says(stated):
    runtime, step_mm = Runtime(stated), 0.5
    point = ForcePoints(stated).at(3.0, PLACE)
    for axis in (0, 1):
        moved = [np.array(PLACE) + sign * step_mm * np.eye(2)[axis] for sign in (1, -1)]
        strength = [ForcePoints(stated).at(3.0, tuple(place)).strength for place in moved]
        template = [runtime.filter.template(place[None])[0] for place in moved]
        rows = np.array([a * t for a, t in zip(strength, template, strict=True)])
        told_N = runtime.inverse.force(runtime.filter.match_at(rows, np.array(PLACE)))[0]
        slope = (told_N[0] - told_N[1]) / (2 * step_mm) / 3.0
        assert abs(slope) == pytest.approx(abs(point.slope_per_mm[axis]), rel=0.05, abs=2e-4)


@pytest.mark.parametrize("entry", list(Entry))
def test_sensitivities_and_bends_are_the_derivatives_of_the_force(stated, entry):
    point = ForcePoints(stated).at(4.0, PLACE)
    step = 1e-3 * (abs(point.strength) if entry is Entry.STRENGTH else 1e-2)
    low, high = (float(point.force_with({entry: np.array([sign * step])})[0]) for sign in (-1, 1))
    assert float(point.force_with({})[0]) == pytest.approx(4.0)
    assert (high - low) / (2 * step) == pytest.approx(point.sensitivity(entry), rel=1e-5)
    assert (high - 8.0 + low) / step**2 == pytest.approx(point.bend(entry), rel=1e-3, abs=1e-4)


def test_few_repeated_loads_widen_the_coverage_factor(stated):
    alone = replace(
        stated,
        standards=(),
        response_per_C=None,
        force=replace(stated.force, scatter=0.2),
    )
    (many,) = evaluate_forces(alone, [5.0], [PLACE])
    (few,) = evaluate_forces(replace(alone, baseline=alone.baseline[:3]), [5.0], [PLACE])
    assert 1.96 < many.k < few.k
    assert {part.name: part.dof for part in few.components}["repeatability"] == 6.6
    assert few.standard_uncertainty_N == pytest.approx(many.standard_uncertainty_N)


@pytest.mark.parametrize(("places", "dof"), [(4, 2), (9, 2), (16, 3), (24, 4)])
def test_the_scatter_of_places_pressed_once_is_widened_to_what_its_few_degrees_of_freedom_give(stated, places, dof):
    once = tuple(BaselineConductance(f"L{n}", 3.0 * n, 0.0, 0.3, 0.01, 1) for n in range(places))
    (few,) = evaluate_forces(replace(stated, baseline=once), [5.0], [PLACE])
    (many,) = evaluate_forces(stated, [5.0], [PLACE])
    wide_N, plain_N = (uncertainties(one)["repeatability"] for one in (few, many))
    assert {part.name: part.dof for part in few.components}["repeatability"] == 5
    assert wide_N * student_t.ppf(0.975, 5) == pytest.approx(plain_N * student_t.ppf(0.975, dof), rel=1e-6)
    # expand() does not take what is beyond the runtime's scatter from the error of the place
    told = Runtime(replace(stated, baseline=once))
    found = told.expand(told.force(frames([PLACE], np.array([3.0]))))[0]
    plain = Runtime(stated)
    usual = plain.expand(plain.force(frames([PLACE], np.array([3.0]))))[0]
    name = "place found in the frame"
    assert uncertainties(found)[name] == pytest.approx(uncertainties(usual)[name])


def test_a_line_whose_slope_and_intercept_are_partly_correlated_has_their_variance(stated):
    line = QuasiStatic(Parameter(4.5e-3, 2e-4, "paper"), Parameter(-1e-3, 2e-3, "assumed"), covariance=-2e-7)
    (expanded,) = evaluate_forces(replace(stated, against_stress=line), [2.0], [PLACE])
    area_mm2 = stated.indenter.area_mm2
    stress_kPa = 2.0 / area_mm2 * 1e3
    variance = (2e-4 * stress_kPa) ** 2 + 2e-3**2 - 2 * stress_kPa * 2e-7
    assert uncertainties(expanded)["characteristic of the material"] == pytest.approx(sqrt(variance) * area_mm2 / 4.5)


@pytest.mark.parametrize("stderr", [None, 0.0])
def test_an_intercept_of_which_no_uncertainty_is_stated_is_named_not_exact(stated, stderr):
    line = QuasiStatic(Parameter(4.5e-3, stderr, "paper"), Parameter(-1e-3, stderr, "assumed"))
    (expanded,) = evaluate_forces(replace(stated, against_stress=line), [2.0], [PLACE])
    assert "characteristic of the material" in expanded.not_stated
    assert "characteristic of the material" not in uncertainties(expanded)


def test_what_comes_from_the_batch_is_a_part_of_the_maps_variance(stated):
    model = replace(stated.force, batch=BatchUse("d" * 64, True, 0.4, 0.25))
    (alone,), (with_batch,) = (evaluate_forces(one, [2.0], [PLACE]) for one in (stated, replace(stated, force=model)))
    whole, parts = uncertainties(alone)["response of the sheet"], uncertainties(with_batch)
    assert parts["response common to the batch"] == pytest.approx(0.5 * whole)
    assert hypot(parts["response common to the batch"], parts["response of the sheet"]) == pytest.approx(whole)


def test_a_shorter_settling_time_adds_the_prediction_of_what_is_to_come(stated):
    kernel = RelaxationKernel(True, np.array([-0.2]), np.array([10.0]), np.zeros((2, 2)), np.array([0.03]), 8.0, 9)
    learned = replace(stated, force=replace(stated.force, loading=kernel, steady_s=1e4))
    (settled,) = evaluate_forces(learned, [2.0], [PLACE])
    (early,) = evaluate_forces(learned, [2.0], [PLACE], settling_s=10.0)
    decay = np.exp(-1.0)
    relative = 0.03 * decay / (1 - 0.2 * decay)
    point = ForcePoints(learned).at(2.0, PLACE)
    expected_N = abs(point.sensitivity(Entry.STRENGTH) * point.strength) * relative
    assert uncertainties(settled)["prediction of transients"] == 0
    assert uncertainties(early)["prediction of transients"] == pytest.approx(expected_N)
    assert {part.name: part.dof for part in early.components}["prediction of transients"] == 8
    (unknown,) = evaluate_forces(stated, [2.0], [PLACE], settling_s=10.0)
    assert "prediction of transients" in unknown.not_stated


def test_random_numbers_stand_beside_a_budget_that_bends_and_repeat(stated):
    (plain,) = evaluate_forces(replace(stated, standards=()), [5.0], [PLACE])
    assert plain.monte_carlo is None
    wide = replace(stated.force, log_response_stderr=np.full_like(stated.force.log_response_stderr, 0.2))
    (bent,), (again,) = (evaluate_forces(replace(stated, force=wide), [5.0], [PLACE]) for _ in range(2))
    assert bent.monte_carlo == again.monte_carlo
    assert "second order" in bent.monte_carlo.why
    assert bent.monte_carlo.half_width == pytest.approx(bent.U_N, rel=0.1)
    # a response that is known by its logarithm leaves the larger forces open
    assert bent.monte_carlo.high - 5.0 > 5.0 - bent.monte_carlo.low


def test_the_grid_is_least_middle_and_greatest_force_at_the_places_that_calibrated(stated):
    grid = evaluate_forces(stated)
    assert [one.force_N for one in grid[:3]] == [1.0, 3.25, 5.5]
    assert len({one.place_mm for one in grid}) == 9
    assert all(one.settling_s == 55.0 and one.dof > 1 for one in grid)


@pytest.mark.parametrize(
    ("change", "arguments", "said"),
    [
        ({"force": None, "no_force": "no load had a force"}, {}, "states no force, and so no uncertainty of it"),
        (
            {"standards": (replace(LOAD_CELL, range_low=2.0),)},
            {},
            "1 N is outside its standard's range: certificate K-1",
        ),
        ({}, {"forces_N": [0.2]}, "a force of 0.2 N is outside the calibrated range, 1 to 5.5 N"),
        ({}, {"forces_N": [-1.0]}, "a force of -1 N is outside the calibrated range"),
        ({}, {"forces_N": [float("nan")]}, "a force of nan N is outside the calibrated range"),
        ({}, {"places_mm": [(40.0, 0.0)]}, "(40, 0) mm is outside the calibrated area, within 36.3 mm"),
        ({}, {"settling_s": -1.0}, "a settling time of -1.0 s is negative"),
        ({"current_A": 0.05}, {}, "the drive current was 50 mA: certificate Q-1"),
    ],
)
def test_what_no_budget_can_be_made_of_is_named(stated, change, arguments, said):
    with pytest.raises(CalibrationError) as caught:
        evaluate_forces(replace(stated, **change), **arguments)
    assert said in caught.value.reason


def test_a_range_that_was_not_measured_gives_no_grid(stated):
    unknown = replace(stated, validity=replace(stated.validity, force_N=None))
    with pytest.raises(CalibrationError, match="the range of force of calibration"):
        evaluate_forces(unknown)
    assert evaluate_forces(unknown, [2.0], [PLACE])[0].dof <= inf


def test_the_runtime_gives_each_told_force_an_expanded_uncertainty(stated):
    runtime = Runtime(stated)
    seen = frames([PLACE, (-10.0, 20.0), (0.0, 0.0)], np.array([2.0, 4.0, 0.0]))
    forces = runtime.force(seen)
    first, second, nothing = runtime.expand(forces)
    assert nothing is None
    for told, frame in ((first, 0), (second, 1)):
        assert told.force_N == forces.force_N[frame]
        assert told.standard_uncertainty_N >= forces.stderr_N[frame]
    known = runtime.expand(runtime.force(seen[:1], place_mm=PLACE))[0]
    assert uncertainties(known)["place found in the frame"] == pytest.approx(0.0, abs=1e-6)
    assert uncertainties(first)["place found in the frame"] > 0
    narrow = Runtime(replace(stated, standards=(replace(LOAD_CELL, range_low=3.0),)))
    assert [one is None for one in narrow.expand(forces)] == [True, False, True]
    (grid,) = evaluate_forces(stated, [known.force_N], [PLACE])
    assert known.standard_uncertainty_N == pytest.approx(grid.standard_uncertainty_N)


def test_what_a_sensor_does_states_U_where_a_load_cell_is_stated(bare, stated):
    words = " ".join(describe_abilities(stated))
    day_N, in_use_N = (
        max(one.U_N for one in evaluate_forces(stated, result=when) if one.force_N == 5.5)
        for when in (Result.ON_THE_DAY, Result.IN_USE)
    )
    assert day_N < in_use_N
    assert f"Expanded uncertainty of 5.5 N: at most U = {day_N:#.2g} N (k = " in words
    assert f"; in use {in_use_N:#.2g} N (k = " in words
    assert "U without: tilt of the head; in use: tilt of the head, ageing of the sensor." in words
    assert "Expanded" not in " ".join(describe_abilities(bare))
    narrow = replace(stated, standards=(replace(LOAD_CELL, range_high=3.0),))
    assert "No expanded uncertainty is stated: 3.25 N is outside" in " ".join(describe_abilities(narrow))


def test_a_budget_of_one_sensor_takes_less_than_a_second(stated):
    evaluate_forces(stated)
    begun_s = time.perf_counter()
    evaluate_forces(stated)
    assert time.perf_counter() - begun_s < 1
