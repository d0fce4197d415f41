"""Trials of several sensors as points: root mean squares, their standard error, refusals, documents."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.report.document import json_document
from cbsr_qa.studies.frontier.point import TimeBasis, restore
from cbsr_qa.studies.frontier.setting import FARTHEST, LEAST_SURE, SUNFLOWER, Setting
from cbsr_qa.studies.frontier.station import Tried, station_points, worth_the_station
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
    ((setting, point),) = station_points(group, lambda setting: seconds)
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


def test_figures_are_root_mean_squares_whatever_their_sign():
    point = only_point(tried(1, gauge_factor_error=0.03), tried(2, gauge_factor_error=-0.04))
    assert point.accuracy["gauge_factor_error"].value == pytest.approx(math.sqrt(0.0025 / 2))
    assert (point.clock, point.station_s, point.compute_s, point.seeds) == (TimeBasis.STATION, 600.0, None, 2)
    assert point.knobs == SETTING.knobs


def test_their_standard_error_is_the_scatter_of_repeated_sweeps():
    random = np.random.default_rng(8)
    sensors, sweeps = 12, 2000
    errors = 0.05 + 0.02 * random.standard_normal((sweeps, sensors))
    points = [only_point(*(tried(k, force_error=value) for k, value in enumerate(row))) for row in errors]
    values = np.array([point.accuracy["force_error"].value for point in points])
    stated = np.array([point.accuracy["force_error"].stderr for point in points])
    # Of 2000 sweeps a standard deviation is known to 1.6 %; terms of second order are (0.02/0.05)²/12 = 1.3 %.
    assert np.sqrt(np.mean(stated**2)) == pytest.approx(values.std(ddof=1), rel=0.06)


def test_one_sensor_has_no_standard_error_and_nothing_at_all_neither():
    assert only_point(tried(1, force_error=0.1)).accuracy["force_error"].stderr is None
    nothing = only_point(tried(1, force_error=0.0), tried(2, force_error=0.0)).accuracy["force_error"]
    assert (nothing.value, nothing.stderr) == (0.0, None)


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
    points = station_points([*group, tried(1, series="b", force_error=3.0)], lambda setting: setting.hold_s)
    assert [(setting, point.series, point.seeds, point.station_s) for setting, point in points] == [
        (SETTING, "a", 2, 60.0),
        (short, "a", 1, 15.0),
        (SETTING, "b", 1, 60.0),
    ]


def test_what_is_worth_the_station_is_compared_over_all_series():
    def point(minutes, force, series="a", mapped=0.02, **more):
        return station_points(
            [tried(1, Setting(3, rest_s=minutes), series=series, force_error=force, map_error=mapped, **more)],
            lambda setting: 60 * minutes,
        )[0][1]

    refused = station_points([tried(1, why="no")], lambda setting: 1.0)[0][1]
    cheap, dear, better = point(10, 0.2), point(20, 0.3, "b"), point(30, 0.1, "b", settling_error=9.0)
    assert [one.pareto for one in worth_the_station([dear, cheap, refused, better])] == [False, True, False, True]
    assert [one.pareto for one in worth_the_station([refused])] == [False]
