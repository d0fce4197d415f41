"""One simulated sensor goes through settings of the frontier, few places and few held-out loads."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cbsr_qa.studies.frontier import station
from cbsr_qa.studies.frontier.sensors import simulate_sensor, station_seconds
from cbsr_qa.studies.frontier.setting import CHECK, GRID, Setting
from cbsr_qa.studies.frontier.station import shorten_holds, try_ways
from cbsr_qa.studies.frontier.trial import UNITS, true_settling_s

SHORT = Setting(6, hold_s=15.0, rest_s=10.0, first_rest_s=60.0)
FEW = replace(SHORT, places=3, hold_s=30.0, checks=1)
SEED = 5


@pytest.mark.rest
def test_short_holds_are_worth_something_only_where_they_are_predicted(monkeypatch):
    monkeypatch.setattr(station, "TEST_LOADS", 6)
    ways = [("tried", replace(SHORT, predicted=predicted)) for predicted in (False, True)]
    averaged, predicted = try_ways(SHORT, SEED, ways)
    for one in (averaged, predicted):
        assert (one.series, one.seed, one.why) == ("tried", SEED, "")
        assert one.errors.keys() == UNITS.keys()
        assert all(math.isfinite(value) for value in one.errors.values())
        assert one.errors["map_error"] < 0.2  # the sheet's own unevenness
    # At 15 s the material still has a fifth of its change before it, and forces go with the change.
    assert averaged.errors["force_error"] > 0.5
    assert predicted.errors["force_error"] < averaged.errors["force_error"] / 3


@pytest.fixture(scope="module")
def few():
    record, _ = simulate_sensor(FEW.recipe(), SEED)
    return record


def test_the_dry_run_says_what_a_run_takes(few):
    said_s = station_seconds(FEW)
    assert sum(dict(few.spent).values()) == pytest.approx(few.station_s)
    # The simulated head begins at home, where a dry run goes first: 6.6 s. Surfaces are found at the first touch.
    assert 0 <= said_s - few.station_s < 10.0


def test_a_shortened_run_is_the_same_up_to_the_end_of_its_holds(few):
    short = shorten_holds(few, 12.0)
    for before, after in zip(few.phases, short.phases, strict=True):
        assert after.frames is before.frames
        for one, other in zip(before.loads, after.loads, strict=True):
            if before.name != GRID:
                assert other == one
                continue
            assert other.release_start_s - other.hold_start_s == pytest.approx(12.0)
            assert replace(other, release_start_s=0.0, release_end_s=0.0, clear_s=None) == replace(
                one, release_start_s=0.0, release_end_s=0.0, clear_s=None
            )
            stroke_s = one.release_end_s - one.release_start_s
            assert other.release_end_s - other.release_start_s == pytest.approx(stroke_s)
    assert {phase.name for phase in short.phases} >= {GRID, CHECK}


def test_holds_that_are_no_longer_than_asked_for_stay(few):
    assert shorten_holds(few, 30.0 + 1e-6).phases == few.phases


def test_the_true_settling_time_is_that_of_the_kernel(few):
    relaxation = few.material.loading_relaxation
    settled_s = true_settling_s(relaxation)
    weights, taus = np.array(relaxation.weights), np.array(relaxation.time_constants_s)
    assert abs(weights @ np.exp(-settled_s / taus)) == pytest.approx(0.15)
    later = settled_s * np.linspace(1.01, 10, 50)
    assert (np.abs(weights @ np.exp(-later / taus[:, None])) < 0.15).all()
