"""The setting to take: the cheapest that is accurate enough, or the most accurate there is time for."""

import pytest
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis
from cbsr_qa.studies.frontier.recommend import USUAL_BUDGET_S, Target, recommend
from cbsr_qa.studies.frontier.setting import Setting


def way(minutes, force_N, stderr=None, places=9):
    accuracy = {} if force_N is None else {"force_error": Accuracy(force_N, stderr, "N")}
    return Setting(places), Point(TimeBasis.STATION, "a", {}, accuracy, None, 60.0 * minutes, 4)


QUICK, MIDDLE, SLOW = way(12, 0.2, 0.02, 10), way(22, 0.1, 0.01, 16), way(90, 0.05, 0.005, 30)
REFUSED = way(5, None, places=3)
ALL = [SLOW, QUICK, REFUSED, MIDDLE]

somewhat = st.lists(
    st.tuples(st.floats(1, 400), st.none() | st.floats(1e-3, 10), st.none() | st.floats(0, 1)), max_size=8
).map(lambda rows: [way(*row) for row in rows])
targets = st.builds(Target, st.none() | st.floats(1e-3, 10), st.none() | st.floats(60, 24000))


def chosen_of(one):
    return one[0], one[1].station_s, one[1].accuracy


def surely(one):
    figure = one[1].accuracy["force_error"]
    return figure.value + (figure.stderr or 0.0)


@given(somewhat, targets)
def test_no_other_setting_meets_the_target_better(tried, target):
    usable = [one for one in tried if one[1].accuracy]
    within = [one for one in usable if target.budget_s is None or one[1].station_s <= target.budget_s]
    if target.budget_s is None and target.force_error_N is None:
        within = [one for one in usable if one[1].station_s <= USUAL_BUDGET_S]
    enough = [one for one in within if target.force_error_N is None or surely(one) <= target.force_error_N]
    if not enough:
        with pytest.raises(RefusedError):
            recommend(tried, target, paper=None)
        return
    found = recommend(tried, target, paper=None)
    assert (found.way, found.station_s, found.accuracy) in map(chosen_of, enough)
    if target.force_error_N is None:
        assert found.accuracy["force_error"].upper == min(map(surely, enough))
    else:
        assert found.station_s == min(one[1].station_s for one in enough)


def test_it_says_what_it_was_chosen_by():
    limit = "whose force error, with its standard error, is at most 0.15 N"
    assert recommend(ALL, Target(0.15), paper=None).why == f"the fastest of 3 settings {limit}"
    assert recommend(ALL, Target(None, 3600.0), paper=None).why == "the most accurate of 2 settings within 60 min"
    said = recommend(ALL, Target(0.15, 1800.0), paper=None).why
    assert said == f"the fastest of 2 settings within 30 min {limit}"


@pytest.mark.parametrize(("paper_N", "words"), [(0.09, "1.11 times"), (0.05, "2.00 times")])
def test_without_a_target_it_is_held_against_the_papers_campaign(paper_N, words):
    why = recommend(ALL, Target(), paper=way(330, paper_N)[1]).why
    assert words in why
    assert ("not within" in why) == (paper_N == 0.05)
    assert "paper" not in recommend(ALL, Target(None, 1500.0), paper=way(330, paper_N)[1]).why
    assert "paper" not in recommend(ALL, Target(), paper=way(330, None)[1]).why


@pytest.mark.parametrize(
    ("target", "asked"),
    [
        (Target(0.01), "has a force error, with its standard error, of at most 0.01 N"),
        (Target(None, 600.0), "takes at most 10 min"),
        (Target(0.06, 3600.0), "of at most 0.06 N in at most 60 min"),
    ],
)
def test_a_target_that_nothing_meets_is_refused_with_the_nearest(target, asked):
    with pytest.raises(RefusedError, match="no setting of 3") as refused:
        recommend(ALL, target, paper=None)
    assert asked in refused.value.reason
    assert "0.050 ± 0.005 N in 90 min" in refused.value.remedy
    assert "0.200 ± 0.020 N in 12 min" in refused.value.remedy


def test_one_sensor_says_nothing_of_a_spread():
    with pytest.raises(RefusedError) as refused:
        recommend([way(23, 0.1)], Target(0.01), paper=None)
    assert "0.100 N in 23 min" in refused.value.remedy


@pytest.mark.parametrize(("tried", "target"), [([REFUSED], Target()), ([], Target(1.0))])
def test_where_nothing_has_a_force_error_that_is_said(tried, target):
    with pytest.raises(RefusedError, match="no setting that was tried has a force error"):
        recommend(tried, target, paper=None)
