"""Trials of several sensors as points: means, their standard error, refusals, documents."""

import math

import pytest
from hypothesis import given, strategies as st

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.report.document import json_document
from cbsr_qa.studies.frontier.point import TimeBasis, restore
from cbsr_qa.studies.frontier.setting import FARTHEST, LEAST_SURE, SUNFLOWER, Setting
from cbsr_qa.studies.frontier.station import (
    PAPER,
    SHIPPED,
    Tried,
    combine_trials,
    list_parts_of_paper,
    list_quick_ways,
    mark_worth_of_station,
    plan_station_work,
)
from cbsr_qa.studies.frontier.trial import UNITS

SETTING = Setting(9)

trials = st.builds(
    Tried,
    st.text(max_size=5),
    st.builds(
        Setting,
        st.integers(1, 50),
        st.lists(st.floats(0.1, 50), min_size=1, max_size=3).map(tuple),
        st.integers(1, 5),
        st.floats(1, 100),
        choice=st.sampled_from([SUNFLOWER, FARTHEST, LEAST_SURE]),
        predicted=st.booleans(),
    ),
    st.integers(0, 10**6),
    st.dictionaries(st.sampled_from(list(UNITS)), st.floats(-10, 10)),
    st.text(max_size=5),
)


def tried(seed, setting=SETTING, why="", series="a", **errors):
    return Tried(series, setting, seed, errors, why)


def only_point(*group, seconds=600.0):
    ((setting, point),) = combine_trials(group, lambda setting: seconds)
    assert setting == SETTING
    return point


@given(trials)
def test_a_trial_survives_its_document(trial):
    assert restore(Tried, json_document(trial)) == trial


@pytest.mark.parametrize(
    "change",
    [
        {"setting": {"places": 3}},
        {"setting": {"places": 3, "strains_percent": [20.0], "colour": "red"}},
        {"setting": None},
        {"errors": {"force_error": "small"}},
        {"errors": {"force_error": math.nan}},
        {"errors": []},
        {"seed": "first"},
    ],
)
def test_a_damaged_trial_is_refused(change):
    document = json_document(tried(1))
    with pytest.raises(StoreError, match="stored Tried"):
        restore(Tried, {**document, **change})
    with pytest.raises(StoreError, match=next(iter(change))):
        restore(Tried, {key: value for key, value in document.items() if key not in change})


def test_values_are_means_over_sensors_whatever_their_sign():
    point = only_point(tried(1, gauge_factor_error=0.03), tried(2, gauge_factor_error=-0.04))
    gauge = point.accuracy["gauge_factor_error"]
    assert (gauge.value, gauge.stderr) == pytest.approx((0.035, 0.005))
    assert gauge.by_sensor == (0.03, 0.04)
    assert (point.clock, point.station_s, point.compute_s, point.seeds) == (TimeBasis.STATION, 600.0, None, 2)
    assert point.knobs == SETTING.knobs


def test_the_papers_campaign_and_the_shipped_recipe_are_named():
    ways = combine_trials([tried(1, PAPER), tried(1, SHIPPED), tried(1)], lambda setting: 600.0)
    assert [point.note for _, point in ways] == ["the paper's campaign", "the shipped recipe nine-locations", ""]


def test_the_shipped_recipe_is_that_of_the_folder():
    recipe = open_document(DocumentKind.RECIPE, "nine-locations").data
    (grid,) = (phase for phase in recipe["phases"] if phase["name"] == "nine locations")
    stated = tuple(grid["strains_percent"]), grid["trials"], grid["hold_s"], grid["rest_s"]
    assert stated == (SHIPPED.strains_percent, SHIPPED.trials, SHIPPED.hold_s, SHIPPED.rest_s)
    assert (SHIPPED.places, SHIPPED.predicted) == (9, recipe["analysis"].get("transients") == "predicted")


def test_the_quick_sweep_shows_the_shipped_recipe_the_papers_campaign_and_six_more():
    quick = [*list_parts_of_paper(), *list_quick_ways(16), *list_quick_ways(9)]
    settings = {setting for _, setting in quick}
    assert {PAPER, SHIPPED} < settings
    assert len(settings) >= 8
    assert len(list(plan_station_work(quick=True))) == 3  # simulations of one sensor


def test_one_sensor_has_no_standard_error_and_nothing_at_all_neither():
    assert only_point(tried(1, force_error=0.1)).accuracy["force_error"].stderr is None
    nothing = only_point(tried(1, force_error=0.0), tried(2, force_error=0.0)).accuracy["force_error"]
    assert (nothing.value, nothing.stderr) == (0.0, 0.0)


def test_a_setting_that_some_sensors_refused_has_no_figures_and_says_why():
    point = only_point(tried(1, force_error=0.1), tried(2, why="no force model can be learned"))
    assert point.accuracy == {}
    assert point.note == "refused on 1 of 2 sensors: no force model can be learned"


def test_a_figure_that_one_sensor_could_not_tell_is_left_out_and_named():
    point = only_point(tried(1, force_error=0.1, settling_error=0.2), tried(2, force_error=0.1))
    assert point.accuracy.keys() == {"force_error"}
    assert point.note == "settling error not determined on 1 of 2"


def test_settings_are_apart_by_series_and_by_every_choice():
    short = Setting(9, hold_s=15.0)
    group = [tried(1, force_error=1.0), tried(2, force_error=1.0), tried(1, short, force_error=2.0)]
    points = combine_trials([*group, tried(1, series="b", force_error=3.0)], lambda setting: setting.hold_s)
    assert [(setting, point.series, point.seeds, point.station_s) for setting, point in points] == [
        (SETTING, "a", 2, 60.0),
        (short, "a", 1, 15.0),
        (SETTING, "b", 1, 60.0),
    ]


def test_what_is_worth_the_station_is_compared_over_all_series():
    def point(minutes, force, series="a", mapped=0.02, **more):
        return combine_trials(
            [tried(1, Setting(3, rest_s=minutes), series=series, force_error=force, map_error=mapped, **more)],
            lambda setting: 60 * minutes,
        )[0][1]

    refused = combine_trials([tried(1, why="no")], lambda setting: 1.0)[0][1]
    cheap, dear, better = point(10, 0.2), point(20, 0.3, "b"), point(30, 0.1, "b", settling_error=9.0)
    assert [one.pareto for one in mark_worth_of_station([dear, cheap, refused, better])] == [False, True, False, True]
    assert [one.pareto for one in mark_worth_of_station([refused])] == [False]
