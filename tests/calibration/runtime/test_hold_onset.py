"""Holds whose ramp no frame shows: predicted without bias, as sure as they are."""

import numpy as np
import pytest

from cbsr_qa.calibration.fits.relaxation import exponentials
from cbsr_qa.calibration.fits.steady_state import HoldsSoFar
from cbsr_qa.calibration.runtime.hold_onset import UnsureHold
from cbsr_qa.domain.results.relaxation import RelaxationKernel

WEIGHTS, TAU_S = np.array([-0.19, -0.54]), np.array([2.6, 22.4])
KERNEL = RelaxationKernel(True, WEIGHTS, TAU_S, np.eye(4) * 1e-5, np.array([0.002, 0.004]), 20.0, 9)
NOISE = 0.004


def frames(ramp_s, late_s, frame_s, until_s, random):
    """Times since the ramp is taken to have ended, and what frames show; it ended so much later."""
    held_s = np.arange(frame_s / 2, until_s, frame_s)
    transient, _ = exponentials(np.maximum(held_s - late_s, 0), TAU_S, ramp_s=ramp_s, frame_s=frame_s)
    return held_s, 1 + transient @ WEIGHTS + NOISE * random.standard_normal(len(held_s))


def predicted(hold, seen):
    for held_s, value in zip(*seen, strict=True):
        hold.add(held_s, value, NOISE)
    return hold


@pytest.mark.parametrize("ramp_s", [0.3, 1.2, 2.0])
@pytest.mark.parametrize("frame_s", [0.25, 2.5])
def test_a_ramp_nobody_told_of_biases_no_prediction(ramp_s, frame_s):
    random = np.random.default_rng(1)
    found = np.array(
        [
            predicted(UnsureHold(KERNEL, frame_s), frames(ramp_s, 0.0, frame_s, 10.0, random)).predict(np.inf)
            for _ in range(40)
        ]
    )
    error, stderr = found[:, 0] - 1, found[:, 1]
    assert abs(error.mean()) < 0.03
    assert 0.4 < np.sqrt(np.mean((error / stderr) ** 2)) < 1.6


def test_taken_for_a_step_it_is_predicted_too_high():
    random = np.random.default_rng(2)
    seen = [frames(2.0, 0.0, 2.5, 5.0, random) for _ in range(40)]
    step = np.mean([predicted(HoldsSoFar(KERNEL), one).predict(at_s=np.inf).values[0] for one in seen]) - 1
    unsure = np.mean([predicted(UnsureHold(KERNEL, 2.5), one).predict(np.inf)[0] for one in seen]) - 1
    assert step > 0.04
    assert abs(unsure) < step / 3


@pytest.mark.parametrize("late_s", [-1.0, 0.5])
def test_where_the_ramp_ended_within_a_frame_is_in_the_error(late_s):
    seen = frames(1.2, late_s, 2.5, 7.5, np.random.default_rng(3))
    value, stderr = predicted(UnsureHold(KERNEL, 2.5), seen).predict(np.inf)
    assert abs(value - 1) < 2.5 * stderr
    longer = predicted(UnsureHold(KERNEL, 2.5), frames(1.2, late_s, 2.5, 60.0, np.random.default_rng(3)))
    assert longer.predict(np.inf) == (pytest.approx(1, abs=0.01), pytest.approx(0.004, abs=0.004))


def test_without_exponentials_it_is_the_mean():
    flat = RelaxationKernel(True, np.zeros(0), np.zeros(0), np.zeros((0, 0)), np.zeros(0), 20.0, 9)
    hold = UnsureHold(flat, 1.0)
    for held_s, value in ((0.5, 2.0), (1.5, 4.0)):
        hold.add(held_s, value, 0.1)
    value, stderr = hold.predict(10.0)
    assert value == pytest.approx(3.0)
    assert stderr == pytest.approx(0.1 / np.sqrt(2))
