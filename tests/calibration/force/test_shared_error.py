"""The part of a force's error that comes from the station's standards, and is the same in all forces of a sensor."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_samples import INDENTER, LOAD_CELL
from force_calibration import force_calibration, frames
from scipy import stats

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.force.shared_error import SharedError
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.calibration.runtime.settling_forces import SettlingForces
from cbsr_qa.calibration.runtime.tracking import ForceStream
from cbsr_qa.domain.plan.standards import describe_force_error
from cbsr_qa.domain.readings.loads import Indenter

HEAD = Indenter(13.0)
NEWTONS = np.array([0.5, 2.0, 5.0])
_PLACES = np.array([(0.0, 0.0), (5.0, 7.0), (-20.3, 10.1)])


def traced(*standards):
    return Calibration(replace(force_calibration(), standards=standards))


def test_an_uncertainty_in_percent_grows_with_the_force_and_one_in_newtons_does_not():
    assert SharedError((LOAD_CELL,), HEAD).stderr_N(NEWTONS) == pytest.approx(0.0025 * NEWTONS, rel=1e-12)
    in_newtons = replace(LOAD_CELL, uncertainty=0.03, k=3.0, unit="N")
    assert SharedError((in_newtons,), HEAD).stderr_N(NEWTONS) == pytest.approx(0.01, rel=1e-12)


def test_the_area_of_the_calibrating_head_counts_for_other_heads_alone():
    shared = SharedError((LOAD_CELL, INDENTER), HEAD)
    assert shared.stderr_N(NEWTONS) == pytest.approx(0.0025 * NEWTONS, rel=1e-12)
    # dA/A = 2 dd/d
    expected = np.hypot(0.0025, 2 * 0.01 / 13.0) * NEWTONS
    assert shared.stderr_N(NEWTONS, other_head=True) == pytest.approx(expected, rel=1e-12)
    of_area = replace(INDENTER, unit="%", uncertainty=0.4)
    assert SharedError((of_area,), HEAD).stderr_N(NEWTONS, other_head=True) == pytest.approx(0.002 * NEWTONS)


def test_without_a_standard_every_digit_stays():
    seen = frames(_PLACES, NEWTONS)
    forces = traced().force(seen)
    assert not forces.shared_stderr_N.any()
    untraced = traced(INDENTER).force(seen)
    assert np.array_equal(untraced.stderr_N, forces.stderr_N)
    assert np.array_equal(untraced.force_N, forces.force_N)


def test_a_stated_load_cell_widens_errors_and_intervals_and_changes_no_force():
    seen = frames(_PLACES, NEWTONS)
    scatter, forces = traced().force(seen), traced(LOAD_CELL).force(seen)
    assert np.array_equal(forces.force_N, scatter.force_N)
    assert np.array_equal(forces.flags, scatter.flags)
    assert forces.shared_stderr_N == pytest.approx(0.0025 * forces.force_N, rel=1e-12)
    assert forces.stderr_N == pytest.approx(np.hypot(scatter.stderr_N, forces.shared_stderr_N), rel=1e-12)
    touches = traced(LOAD_CELL).estimate(seen)
    assert np.array_equal(touches.force.shared_stderr, forces.shared_stderr_N)
    half_width_N = np.diff(touches.force.within_95, axis=1)[:, 0] / 2
    assert half_width_N == pytest.approx(stats.norm.ppf(0.975) * forces.stderr_N, rel=1e-9)


def test_several_heads_share_the_error_of_their_sum():
    seen = frames(_PLACES[:1], NEWTONS[2:])
    (alone,), (together,) = traced().forces(seen), traced(LOAD_CELL).forces(seen)
    shared_N = 0.0025 * alone.total_N
    assert together.total_stderr_N == pytest.approx(np.hypot(alone.total_stderr_N, shared_N), rel=1e-12)
    assert together.loads.shared_stderr_N.sum() == pytest.approx(shared_N, rel=1e-9)


def test_nothing_is_added_where_nothing_presses():
    unloaded = force_calibration().reference
    forces = traced(LOAD_CELL).force(unloaded)
    assert forces.flags[0] & Flag.NOT_DETECTED
    assert forces.shared_stderr_N[0] == 0.0
    assert np.array_equal(forces.stderr_N, traced().force(unloaded).stderr_N)


def test_forces_followed_over_time_carry_it_once():
    rest = np.repeat(force_calibration().reference[None], 3, axis=0)
    seen = np.concatenate([rest, frames(np.repeat(_PLACES[:1], 12, axis=0), np.full(12, 2.0))])
    times_s = np.arange(len(seen)) * 0.5

    def follow(calibration):
        return SettlingForces(calibration)(times_s, seen, calibration.force(seen))[0]

    scatter, forces = follow(traced()), follow(traced(LOAD_CELL))
    assert np.array_equal(forces.force_N, scatter.force_N)
    assert (forces.shared_stderr_N > 0).any()
    assert forces.stderr_N == pytest.approx(np.hypot(scatter.stderr_N, forces.shared_stderr_N), rel=1e-9)


def test_loads_that_a_stream_follows_carry_it_too():
    rest = np.repeat(force_calibration().reference[None], 3, axis=0)
    seen = np.concatenate([rest, frames(np.repeat(_PLACES[:1], 12, axis=0), np.full(12, 2.0))])

    def follow(calibration):
        stream = ForceStream(calibration)
        return [stream.update(0.5 * n, frame) for n, frame in enumerate(seen)][-1][0]

    scatter, load = follow(traced()), follow(traced(LOAD_CELL))
    assert (load.force_N, load.scatter_N) == pytest.approx((scatter.force_N, scatter.stderr_N), rel=1e-9)
    assert load.shared_stderr_N == pytest.approx(0.0025 * load.force_N, rel=1e-12)
    assert load.stderr_N == pytest.approx(np.hypot(scatter.stderr_N, load.shared_stderr_N), rel=1e-12)


def test_intervals_hold_when_each_load_cell_errs_as_its_certificate_states():
    """Many sensors, each calibrated with its own load cell: alone, scatter would hold too little."""
    random = np.random.default_rng(20261129)
    standard = replace(LOAD_CELL, uncertainty=4.0)
    scatter_N, truth_N, sensors, loads = 0.04, 3.0, 2000, 5
    factor = 1 + standard.standard_uncertainty * random.standard_normal((sensors, 1))
    estimates_N = truth_N * factor + scatter_N * random.standard_normal((sensors, loads))
    stderr_N = np.hypot(scatter_N, SharedError((standard,), HEAD).stderr_N(estimates_N))
    held = np.abs(estimates_N - truth_N) <= 1.96 * stderr_N
    assert held.mean() == pytest.approx(0.95, abs=0.015)
    mean_N, shared_N = estimates_N.mean(axis=1), standard.standard_uncertainty * truth_N
    assert mean_N.std() == pytest.approx(np.hypot(shared_N, scatter_N / np.sqrt(loads)), rel=0.06)


def test_what_errors_include_is_said_in_words():
    assert describe_force_error(()) == "scatter only; load cell not stated"
    assert describe_force_error((INDENTER,)) == "scatter only; load cell not stated"
    assert describe_force_error((INDENTER, LOAD_CELL)) == (
        "scatter and load cell (U = 0.5 % (k = 2), certificate K-2026-0711 of D-K-15000, due 2027-03-31)"
    )
    assert traced(LOAD_CELL).force_error == describe_force_error((LOAD_CELL,))
