"""The setting to take: the fastest that is accurate enough, or the most accurate in a time."""

import pytest
from hypothesis import given, strategies as st

from benchmarks.setting_choice import SCATTERS, simulate_choices
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis
from cbsr_qa.studies.frontier.recommend import CONFIDENCE, USUAL_BUDGET_S, Target, recommend
from cbsr_qa.studies.frontier.setting import Setting


def way(minutes, *forces_N, places=9):
    accuracy = {"force_error": Accuracy.from_sensors(forces_N, "N")} if forces_N else {}
    point = Point(TimeBasis.STATION, "a", {}, accuracy, None, 60.0 * minutes, max(1, len(forces_N)))
    return Setting(places), point


QUICK = way(12, 0.18, 0.2, 0.22, 0.2, places=10)
MIDDLE = way(22, 0.09, 0.1, 0.11, 0.1, places=16)
SLOW = way(90, 0.045, 0.05, 0.055, 0.05, places=30)
REFUSED = way(5, places=3)
ALL = [SLOW, QUICK, REFUSED, MIDDLE]
PAPER_MINUTES = 330

somewhat = st.lists(
    st.tuples(st.floats(1, 400), st.lists(st.floats(1e-3, 10), min_size=2, max_size=4)), max_size=8
).map(lambda rows: [way(minutes, *forces, places=3 + number) for number, (minutes, forces) in enumerate(rows)])
targets = st.builds(Target, st.none() | st.floats(1e-3, 10), st.none() | st.floats(60, 24000))


def confirmed(tried):
    """New sensors on which every setting is as on those of the sweep."""
    return dict(tried).__getitem__


def chosen(target, tried=ALL, paper=None, confirm=None):
    return recommend(tried, target, paper=paper, confirm=confirm or confirmed(tried))


def bound_N(one):
    return one[1].accuracy["force_error"].upper_bound(CONFIDENCE)


@given(somewhat, targets)
def test_no_other_setting_meets_the_target_better(tried, target):
    budget_s = USUAL_BUDGET_S if target == Target() else target.budget_s
    within = [one for one in tried if budget_s is None or one[1].station_s <= budget_s]
    enough = [one for one in within if target.force_error_N is None or bound_N(one) <= target.force_error_N]
    if not enough:
        with pytest.raises(RefusedError):
            chosen(target, tried)
        return
    found = chosen(target, tried)
    assert found.way in {one[0] for one in enough}
    if target.force_error_N is None:
        assert found.accuracy["force_error"].value == min(one[1].accuracy["force_error"].value for one in enough)
    else:
        assert found.station_s == min(one[1].station_s for one in enough)


def test_it_says_what_it_was_chosen_by():
    limit = "with a mean force error below 0.15 N with 90 % confidence, on 4 sensors and again on 4 new ones"
    assert chosen(Target(0.15)).why == f"the fastest of 3 settings {limit}"
    assert chosen(Target(0.15, 1800.0)).why == f"the fastest of 2 settings within 30 min {limit}"
    smallest = "the smallest mean force error of 2 settings within 60 min on 4 sensors"
    assert chosen(Target(None, 3600.0)).why == f"{smallest}; the error stated is that of 4 new ones"


def test_a_setting_that_new_sensors_do_not_confirm_is_passed_over():
    new = {QUICK[0]: QUICK[1], MIDDLE[0]: way(22, 0.1, 0.2, 0.15)[1], SLOW[0]: SLOW[1]}
    found = chosen(Target(0.15), confirm=new.get)
    assert (found.way, found.seeds) == (SLOW[0], 4)
    with pytest.raises(RefusedError, match="on new sensors too; the fastest 2 were tried"):
        chosen(Target(0.15), confirm={**new, SLOW[0]: REFUSED[1]}.get)


def test_what_is_stated_is_of_new_sensors():
    new = way(22, 0.12, 0.14, 0.16, 0.14, 0.13)[1]
    found = chosen(Target(None, 3600.0), confirm={MIDDLE[0]: new}.get)
    assert (found.way, found.accuracy, found.seeds) == (MIDDLE[0], new.accuracy, 5)
    found = chosen(Target(None, 3600.0), confirm={MIDDLE[0]: REFUSED[1], QUICK[0]: QUICK[1]}.get)
    assert found.way == QUICK[0]


def test_a_setting_without_a_rival_is_the_only_one():
    assert chosen(Target(None, 900.0)).why.startswith("the only setting within 15 min that was tried on 4 sensors")
    assert chosen(Target(0.3, 900.0)).why.startswith("the only setting within 15 min that was tried with a mean")


def test_settings_that_cannot_be_told_from_the_best_are_counted():
    alike = way(20, 0.08, 0.13, 0.12, 0.1, places=14)
    why = chosen(Target(None, 3600.0), [*ALL, alike]).why
    assert "; 1 other cannot be distinguished from it" in why


@pytest.mark.parametrize(
    ("paper_N", "words"),
    [
        (
            (0.09, 0.1, 0.11, 0.1),
            "1.00 ± 0.00 times that of the paper's campaign on the same sensors, within",
        ),
        (
            (0.045, 0.05, 0.055, 0.05),
            "2.00 ± 0.00 times that of the paper's campaign on the same sensors, not within",
        ),
        ((0.05, 0.15, 0.05, 0.1), "not surely within the 1.2 asked for"),
    ],
)
def test_without_a_target_it_is_held_against_the_papers_campaign(paper_N, words):
    paper = way(PAPER_MINUTES, *paper_N)[1]
    assert words in chosen(Target(), paper=paper).why
    assert "paper" not in chosen(Target(None, 1500.0), paper=paper).why
    assert "paper" not in chosen(Target(), paper=way(PAPER_MINUTES)[1]).why


@pytest.mark.parametrize(
    ("target", "asked", "count", "nearest"),
    [
        (Target(0.01), "has a mean force error below 0.01 N with 90 % confidence", 3, "0.050 ± 0.002 N in 90 min"),
        (Target(None, 600.0), "takes at most 10 min", 3, "0.050 ± 0.002 N in 90 min"),
        (Target(0.06, 3600.0), "has a mean force error below 0.06 N", 2, "0.100 ± 0.004 N in 22 min"),
    ],
)
def test_a_target_that_nothing_meets_is_refused_with_the_nearest(target, asked, count, nearest):
    with pytest.raises(RefusedError, match=f"no setting of {count}") as refused:
        chosen(target)
    assert asked in refused.value.reason
    assert f"the most accurate has {nearest}" in refused.value.remedy
    assert "the quickest 0.200 ± 0.008 N in 12 min" in refused.value.remedy


def test_from_one_sensor_no_accuracy_follows_and_nothing_is_confirmed():
    one_sensor = [way(23, 0.1), way(12, 0.2, places=10)]
    with pytest.raises(RefusedError, match="one simulated sensor does not show how sensors scatter") as refused:
        chosen(Target(0.15), one_sensor)
    assert refused.value.remedy == "run the sweep without --quick"
    found = recommend(one_sensor, Target(None, 3600.0), paper=None, confirm=None)
    assert (found.way, found.seeds) == (one_sensor[0][0], 1)
    assert "on one simulated sensor; on others another setting may be better" in found.why
    assert "accurate" not in found.why


@pytest.mark.parametrize(("tried", "target"), [([REFUSED], Target()), ([], Target(1.0))])
def test_where_nothing_has_a_force_error_that_is_said(tried, target):
    with pytest.raises(RefusedError, match="no setting that was tried has a force error"):
        chosen(target, tried)


@pytest.mark.parametrize("scatter", SCATTERS)
def test_at_most_one_choice_in_ten_misses_the_target(scatter):
    command, by_one_stderr = simulate_choices(scatter, 250)
    assert command.made > 80
    assert command.missed <= 0.1 * command.made
    assert by_one_stderr.missed > 0.1 * by_one_stderr.made or scatter < 0.2
