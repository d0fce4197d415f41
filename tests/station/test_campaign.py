"""The recipe ``campaign``: what the shipped station is asked for, and that it allows it."""

import numpy as np
import pytest

from cbsr_qa.app.run.preflight import check_recipe, check_unloaded
from cbsr_qa.config.loader import load_scene
from cbsr_qa.domain.plan.steps import Press
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.station.dry_runs import dry_run
from cbsr_qa.station.setup import configure, plan_of

CAMPAIGN = configure("simulated", "campaign", sensor_type=None, material=None, seed=11)


@pytest.fixture(scope="module")
def dry():
    return dry_run(plan_of(CAMPAIGN, discover()), load_scene("base").value.frame_period_s)


def presses(dry, name):
    (phase,) = [phase for phase in dry.phases if phase.scheduled.name == name]
    return [s.step.load for s in phase.scheduled.steps if isinstance(s.step, Press)]


def test_the_shipped_station_allows_it(dry):
    assert dry.violations == ()
    assert 8 * 3600 < dry.duration_s < 10 * 3600  # the station file says 9.7 hours
    plugins = discover()
    check_recipe(CAMPAIGN.recipe, CAMPAIGN.sensor_type, plugins)
    check_unloaded(plan_of(CAMPAIGN, plugins), CAMPAIGN.recipe)


def test_the_papers_grid_is_pressed_at_six_strains_three_times(dry):
    loads = presses(dry, "nine locations")
    assert len(set(loads)) == len(loads) == 9 * 6 * 3
    assert {(load.x_mm, load.y_mm) for load in loads} == set(NINE_LOCATIONS_MM)
    assert {load.strain for load in loads} == {0.05, 0.10, 0.15, 0.20, 0.25, 0.30}


def test_calibration_places_are_a_sunflower_lattice_over_40_mm(dry):
    loads = presses(dry, "calibration places")
    places = np.array([(load.x_mm, load.y_mm) for load in loads])
    k = np.arange(30)
    radius, angle = 40 * np.sqrt((k + 0.5) / 30), k * np.pi * (3 - np.sqrt(5))
    assert places == pytest.approx(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]), abs=0.051)
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    nearest = np.min(apart + 1e3 * np.eye(30), axis=1)
    assert 11 < nearest.min() < nearest.max() < 13.5
    assert np.hypot(*np.diff(places, axis=0).T).min() > 11  # no press beside the one before it
    assert {load.strain for load in loads} == {0.25}


def test_places_of_its_grids_have_names_of_their_own(dry):
    names = {name: {load.label for load in presses(dry, name)} for name in ("nine locations", "calibration places")}
    assert not names["nine locations"] & names["calibration places"]
    assert CAMPAIGN.recipe.calibrate_phases == tuple(names)
