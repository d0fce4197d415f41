"""Limits against measurements, and metrics that fail."""

from types import SimpleNamespace

import pytest
from copied import come_back, fork, fork_and_leave
from hypothesis import given, strategies as st

from cbsr_qa.analysis.evaluate import judge, judge_again, measure_run
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.limits import Bound, Limit, Outcome
from cbsr_qa.domain.results.measurement import Measurement, decide, explain_verdict

numbers = st.floats(-1e6, 1e6)


def _limit(**changes):
    return Limit(**{"measurement": "error", "unit": "mm", "lower": None, "upper": 2.0, "marginal": 0.5} | changes)


@pytest.mark.parametrize(
    ("value", "outcome"),
    [(1.0, Outcome.PASS), (1.5, Outcome.PASS), (1.6, Outcome.MARGINAL), (2.0, Outcome.MARGINAL), (2.1, Outcome.FAIL)],
)
def test_outcome_by_distance_from_the_limit(value, outcome):
    (judged,) = judge([Measurement("error", value, "mm")], [_limit()])
    assert judged.outcome is outcome


def test_a_value_nobody_could_determine_never_passes():
    (judged,) = judge([Measurement("error", None, "mm", how="no blob")], [_limit()])
    assert judged.outcome is Outcome.NOT_MEASURED
    verdict = decide((judged,))
    assert verdict.outcome.exit_code == 3
    assert "no blob" in verdict.reason


def test_a_limit_nobody_measures_is_not_measured():
    judged = judge([Measurement("other", 1.0, "mm")], [_limit()])
    assert [m.outcome for m in judged] == [Outcome.NOT_JUDGED, Outcome.NOT_MEASURED]


def test_a_limit_in_another_unit_judges_nothing_and_never_passes():
    judged = judge([Measurement("error", 1.0, "µm")], [_limit()])
    assert [m.outcome for m in judged] == [Outcome.NOT_JUDGED, Outcome.NOT_MEASURED]
    assert "the limit is in mm, the measurement in µm" in decide(judged).reason
    with pytest.raises(RefusedError, match="limit of error is in mm, the measurement in µm"):
        Measurement("error", 1.0, "µm").judge(_limit())


def test_a_limit_judges_only_its_phase_and_qualifier():
    measurements = [
        Measurement("error", 9.0, "mm", phase="grid"),
        Measurement("error", 9.0, "mm", phase="random"),
        Measurement("error", 9.0, "mm", phase="grid", qualifier="mask 25 %"),
    ]
    judged = judge(measurements, [_limit(phase="grid")])
    assert [m.outcome for m in judged] == [Outcome.FAIL, Outcome.NOT_JUDGED, Outcome.NOT_JUDGED]


def test_of_two_limits_the_stricter_outcome_counts_in_either_order():
    loose, tight = _limit(upper=10.0), _limit(upper=1.0)
    for limits in ([loose, tight], [tight, loose]):
        (judged,) = judge([Measurement("error", 3.0, "mm")], limits)
        assert judged.outcome is Outcome.FAIL
        assert judged.limit is tight


@pytest.mark.parametrize(
    ("value", "lower", "upper", "outcome"),
    [
        (60.0, None, 60.0, Outcome.NOT_MEASURED),  # at least 60: perhaps 600
        (61.0, None, 60.0, Outcome.FAIL),
        (61.0, 60.0, None, Outcome.PASS),
        (59.0, 60.0, None, Outcome.NOT_MEASURED),
        (59.0, 50.0, 60.0, Outcome.NOT_MEASURED),
    ],
)
def test_a_lower_bound_never_meets_an_upper_limit(value, lower, upper, outcome):
    measurement = Measurement("settling", value, "s", bound=Bound.LOWER)
    judged = measurement.judge(Limit("settling", "s", lower, upper))
    assert judged.outcome is outcome


@given(numbers, numbers, numbers, st.floats(0, 1e3))
def test_judging_agrees_with_the_definition(value, one, other, marginal):
    lower, upper = sorted([one, other])
    outcome = Limit("error", "mm", lower, upper, marginal).judge(value)
    if not lower <= value <= upper:
        assert outcome is Outcome.FAIL
    elif min(value - lower, upper - value) < marginal:
        assert outcome is Outcome.MARGINAL
    else:
        assert outcome is Outcome.PASS


@given(st.lists(numbers, min_size=1, max_size=8))
def test_the_verdict_is_the_worst_and_its_reason_the_furthest_out(values):
    judged = judge([Measurement("error", v, "mm", location=f"L{i}") for i, v in enumerate(values)], [_limit()])
    verdict = decide(judged)
    assert (verdict.outcome is Outcome.FAIL) == (max(values) > 2.0)
    if verdict.outcome is Outcome.FAIL:
        said = float(verdict.reason.split(" is ")[1].split(" mm")[0])
        assert said == pytest.approx(max(values), rel=1e-3)


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_a_measurement_is_never_nan(number):
    with pytest.raises(RefusedError, match="not a finite number"):
        Measurement("error", number, "mm")


class _Broken:
    def measure_run(self, run):
        raise ZeroDivisionError("nothing was pressed")


class _Whole:
    def measure_run(self, run):
        return (Measurement("whole", 1.0, "1"),)


def test_a_metric_that_raises_takes_nothing_else_down():
    measured, warnings = measure_run(SimpleNamespace(loads=()), {"broken": _Broken(), "whole": _Whole()})
    assert [m.name for m in measured] == ["whole"]
    assert "metric broken failed" in warnings[0]
    assert "nothing was pressed" in warnings[0]


@pytest.mark.parametrize("code", [fork, fork_and_leave])
def test_a_copy_that_a_metric_forks_does_not_come_back(code):
    metric = SimpleNamespace(measure_run=code)
    assert come_back(lambda: measure_run(SimpleNamespace(loads=()), {"forks": metric})) == 1


def test_a_failed_run_says_how_many_limits_fail():
    limits = (Limit("force", "N", None, 3.0), Limit("drift", "1", None, 0.1))
    force, other = Measurement("force", 3.8, "N"), Measurement("drift", 0.2, "1")
    both = (force.judge(limits[0]), other.judge(limits[1]))
    assert explain_verdict(decide(both), both).startswith("2 of 2 limits fail; worst: drift is 0.2")
    one = (force.judge(limits[0]), Measurement("drift", 0.05, "1").judge(limits[1]))
    assert explain_verdict(decide(one), one) == "1 of 2 limits fails: force is 3.8 N (allowed: at most 3 N)"
    alone = (force.judge(limits[0]), Measurement("area", 5.0, "mm²"))
    assert explain_verdict(decide(alone), alone) == decide(alone).reason


LIMITS = (
    Limit("error", "mm", None, 1.0),
    Limit("error", "µm", None, 1.0),  # judges nothing
    Limit("nothing", "1", 0.0, None),  # nothing measures it
    Limit("noise", "1", None, 0.1),
)


@given(
    st.lists(st.builds(Measurement, st.sampled_from(["error", "noise"]), st.none() | st.floats(0, 2), st.just("mm"))),
    st.lists(st.sampled_from(LIMITS), unique=True),
    st.lists(st.sampled_from(LIMITS), unique=True),
)
def test_what_was_judged_before_does_not_matter(measured, before, now):
    assert judge_again(judge(measured, before), now) == judge(measured, now)
