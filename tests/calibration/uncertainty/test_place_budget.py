"""Budgets of places: the radius of a circle, noise of a frame, and what is learned elsewhere."""

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from force_calibration import force_calibration, frames

from cbsr_qa.calibration.runtime.calibration import Calibration as Runtime
from cbsr_qa.calibration.uncertainty.places import evaluate_places, radius_of_circle
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.plan.standards import ReferenceStandard

PLACE = (12.5, -7.0)
STAGE = ReferenceStandard("stage", "S-1", "Lab", "2026-01-01", "2027-01-01", 0.6, 2.0, "mm")


@pytest.mark.parametrize(
    ("covariance", "radius"),
    [
        (np.eye(2), sqrt(-2 * np.log(0.05))),
        (4 * np.eye(2), 2 * sqrt(-2 * np.log(0.05))),
        (np.diag([1.0, 0.0]), 1.95996),
        (np.zeros((2, 2)), 0.0),
    ],
)
def test_a_circle_of_95_percent_is_that_of_exact_cases(covariance, radius):
    assert radius_of_circle(covariance) == pytest.approx(radius, rel=1e-4)


@pytest.mark.parametrize("ratio", [0.1, 0.5])
def test_a_circle_holds_what_it_states_of_an_oblong_cloud(ratio):
    turned = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    covariance = turned @ np.diag([1.0, ratio]) @ turned.T
    drawn = np.random.default_rng(8).multivariate_normal([0, 0], covariance, 200_000)
    assert np.mean(np.hypot(*drawn.T) <= radius_of_circle(covariance)) == pytest.approx(0.95, abs=0.002)


def test_without_scatter_a_place_is_as_uncertain_as_the_runtime_says():
    calibration = force_calibration()
    calibration = replace(calibration, force=replace(calibration.force, place_scatter_mm=0.0))
    told = Runtime(calibration).force(frames([PLACE], np.array([4.0]), noise=0.0))
    place_mm = tuple(told.place_mm[0].tolist())
    (expanded,) = evaluate_places(calibration, [float(told.force_N[0])], [place_mm])
    assert expanded.budget.standard_uncertainty == pytest.approx(float(told.place_stderr_mm[0]), rel=0.05)
    assert expanded.budget.not_stated == ("drift of gains since the reference", "place of indentation")


def test_a_drift_of_all_gains_moves_the_place_that_the_runtime_finds_as_much():
    meter = ReferenceStandard("source_meter", "Q", "Lab", "2026-01-01", "2027-01-01", 0.1, 2.0, "%", 0.01)
    calibration = replace(force_calibration(), standards=(meter,))
    runtime, frame = Runtime(calibration), frames([PLACE], np.array([4.0]), noise=0.0)
    told, up, down = (runtime.force(frame * (1 + sign * 0.0001 / sqrt(3))) for sign in (0, 1, -1))
    (expanded,) = evaluate_places(calibration, [float(told.force_N[0])], [tuple(told.place_mm[0].tolist())])
    (drift,) = [part for part in expanded.budget.components if part.name == "drift of gains since the reference"]
    distance_mm = float(np.hypot(*(up.place_mm - down.place_mm)[0])) / 2
    assert drift.standard_uncertainty == pytest.approx(distance_mm / sqrt(2), rel=0.05)


def test_a_stage_is_part_of_a_place_and_shared():
    calibration = replace(force_calibration(), standards=(STAGE,))
    (expanded,) = evaluate_places(calibration, [4.0], [PLACE])
    (stage,) = [part for part in expanded.budget.components if part.name == "place of indentation"]
    assert (stage.standard_uncertainty, stage.shared) == (0.3, True)
    assert expanded.U_mm > sqrt(-2 * np.log(0.05)) * 0.3 * (1 - 1e-9)


def test_learned_places_state_regions_of_their_own():
    with pytest.raises(CalibrationError, match="learned from its presses"):
        evaluate_places(replace(force_calibration(), place=object()))
