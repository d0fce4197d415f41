"""Ways to calibrate: every one is a recipe that a station takes."""

import tomllib
from functools import lru_cache

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.config.text import toml_document
from cbsr_qa.domain.readings.loads import sunflower_mm
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.station.dry_runs import dry_run
from cbsr_qa.station.setup import plan_of
from cbsr_qa.studies.frontier.setting import GRID, RADIUS_MM, Setting, phase_of_test_loads
from cbsr_qa.studies.frontier.station import (
    EVEN,
    PAPER,
    list_choices_of_even,
    list_parts_of_even,
    list_parts_of_paper,
    list_quick_ways,
    list_simulated_ways,
)
from cbsr_qa.studies.simulated import configuration_of

BASE = open_document(DocumentKind.RECIPE, "campaign").data
discovered = lru_cache(discover)

strains = st.sampled_from([5.0, 10.0, 15.0, 20.0, 25.0, 30.0])
ways = st.builds(
    Setting,
    places=st.integers(3, 40),
    strains_percent=st.lists(strains, min_size=1, max_size=6, unique=True).map(tuple),
    trials=st.integers(1, 3),
    hold_s=st.floats(5, 120),
    rest_s=st.floats(0, 120),
    predicted=st.booleans(),
    steady_frames=st.integers(1, 8),
    first_rest_s=st.floats(0, 600),
    checks=st.integers(0, 30),
)


def planned(document):
    station = open_document(DocumentKind.STATION, "simulated").data
    return plan_of(configuration_of(station, document, "cbsr-8wt", seed=1), discovered())


def dry(setting):
    document = tomllib.loads(toml_document(setting.recipe("tried")))
    return dry_run(planned(document), setting.frame_period_s)


@drawn(40)
@given(ways)
def test_every_setting_is_a_recipe_that_the_station_takes(setting):
    recipe = setting.recipe("tried")
    walked = dry(setting)
    too_long = "the run takes"  # as it may: 40 places, six strains, three trials, two minutes each
    assert [broken for broken in walked.violations if not broken.startswith(too_long)] == []
    grid = setting.places * len(setting.strains_percent) * setting.trials
    assert walked.loads == 1 + grid + setting.checks
    assert walked.duration_s >= setting.first_rest_s + grid * (setting.hold_s + setting.rest_s)
    assert all(limit in BASE["limits"] for limit in recipe["limits"])
    assert {key: recipe[key] for key in ("metrics", "reconstruction")} == {
        key: BASE[key] for key in ("metrics", "reconstruction")
    }


@given(ways)
def test_limits_are_of_phases_that_are_there_and_the_base_is_left_alone(setting):
    before = toml_document(BASE)
    recipe = setting.recipe("tried")
    recipe["limits"].clear()
    recipe["analysis"]["overlap_bands"].clear()
    assert toml_document(BASE) == before
    recipe = setting.recipe("tried")
    phases = {phase["name"] for phase in recipe["phases"]}
    assert {limit["phase"] for limit in recipe["limits"] if "phase" in limit} <= phases
    assert recipe["recipe"]["calibrate_phases"] == [GRID]


def test_more_presses_take_longer_and_shorter_rests_less():
    few, many = Setting(9, rest_s=30.0), Setting(12, rest_s=30.0)
    assert dry(few).duration_s < dry(many).duration_s
    quick = Setting(9, rest_s=5.0)
    # Random loads keep their half minute, and what recovery the noise figure's press is spared stands before them.
    assert dry(few).duration_s - dry(quick).duration_s == pytest.approx(9 * 25.0)


def test_what_needs_more_presses_is_not_judged():
    def measured(setting):
        return {(limit["measurement"], limit.get("qualifier")) for limit in setting.recipe("x")["limits"]}

    everything = Setting(9, (10.0, 20.0, 30.0), trials=2, checks=30, rest_s=60.0)
    assert measured(everything) == {(limit["measurement"], limit.get("qualifier")) for limit in BASE["limits"]}
    short = Setting(16, hold_s=15.0, rest_s=5.0, predicted=True)
    gone = {name for name, _ in measured(everything) - measured(short)}
    of_force = {"force_error_sd", "force_error_bias", "force_coverage_68"}
    assert gone == {"repeatability", "nonlinearity", "common_settling_time", *of_force}
    assert ("common_settling_time", "conductance, loading") in measured(short)


@given(st.integers(1, 200))
def test_a_sunflower_lies_in_its_disc_with_room_between(count):
    places = np.array(sunflower_mm(count, RADIUS_MM))
    assert places.shape == (count, 2)
    assert (np.hypot(*places.T) <= RADIUS_MM).all()
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))[~np.eye(count, dtype=bool)]
    # One each 40² π/n mm²; in a hexagonal lattice as dense neighbours are 1.90 · 40 mm/√n apart.
    assert (apart >= 1.5 * RADIUS_MM / np.sqrt(count) - 0.15).all()


@given(st.integers(3, 60))
def test_a_sunflower_is_as_dense_everywhere(count):
    radius = np.hypot(*np.array(sunflower_mm(count, RADIUS_MM)).T)
    for share in (0.25, 0.5, 0.75):
        inside = (radius <= RADIUS_MM * np.sqrt(share)).sum()
        assert abs(inside - share * count) <= 1.0


def test_the_places_of_the_shipped_campaign_are_the_sunflower_of_thirty():
    (phase,) = [phase for phase in BASE["phases"] if phase["name"] == GRID]
    assert [tuple(place) for place in phase["locations_mm"]] == list(sunflower_mm(30, RADIUS_MM))


def test_held_out_loads_are_drawn_by_themselves():
    document = Setting(4).recipe("tried")
    document["phases"].append(phase_of_test_loads(7))
    walked = dry_run(planned(document), 2.5)
    assert walked.violations == ()
    assert walked.phases[-1].scheduled.loads == 7


def test_every_setting_of_the_sweeps_is_within_what_is_simulated_for_it():
    for _, setting in list_parts_of_paper():
        assert set(setting.strains_percent) <= set(PAPER.strains_percent)
        assert setting.trials <= PAPER.trials
        assert (setting.places, setting.hold_s, setting.rest_s) == (PAPER.places, PAPER.hold_s, PAPER.rest_s)
    for _, setting in (*list_parts_of_even(), *list_choices_of_even()):
        assert setting.places <= EVEN.places
        assert setting.hold_s <= EVEN.hold_s
        assert (setting.strains_percent, setting.rest_s) == (EVEN.strains_percent, EVEN.rest_s)
    whole = [*list_parts_of_paper(), *list_parts_of_even(), *list_simulated_ways()]
    assert len(set(whole)) == len(whole)
    for _, setting in {*whole, *list_quick_ways(9), *list_quick_ways(16)}:
        assert dry(setting).violations == ()
