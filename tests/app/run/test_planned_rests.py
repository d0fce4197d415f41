"""A dry run of a recipe whose first rest ends when the sheet is stable says least and most."""

from dataclasses import replace

from cbsr_qa.app.run.planned import PlannedRun, plan_outcome
from cbsr_qa.domain.plan.steps import AcquireFrames, Hold, MarkUnloaded, Press, Release, Settle
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.changes import SensorHistory
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.station.dry_runs import dry_run
from cbsr_qa.testing.bench import example_plan

CYCLE = (Press(Load("L0", 0.0, 0.0, 0.2, 0)), Hold(60, acquire=True), Release(), Hold(60, acquire=True))


def planned(rest):
    plan = example_plan((rest, MarkUnloaded(), AcquireFrames(16), *CYCLE))
    sensor = SensorIdentity("EXAMPLE-001", "example", "disc-100mm")
    return PlannedRun.from_dry_run(dry_run(plan, 2.5), SensorHistory(sensor, "example"), ())


def test_a_rest_that_may_end_sooner_is_counted_to_its_end_and_to_its_least():
    fixed, settling = planned(Hold(240.0, acquire=False)), planned(Settle(240.0, True, 60.0, 0.25))
    assert fixed.least_s == fixed.duration_s == settling.duration_s
    assert settling.least_s == settling.expected_s == settling.duration_s - 180
    (_, shown), *_ = plan_outcome(settling).page.identity
    assert shown.startswith("3 min 55 s to 6 min 55 s (")
    assert " to " not in plan_outcome(fixed).page.identity[0][1].split("(")[0]


def test_a_dry_run_says_that_no_operator_is_named():
    nobody, somebody = (
        planned(Hold(240.0, acquire=False)),
        replace(planned(Hold(240.0, acquire=False)), operator="Ada"),
    )
    words = ("Operator", "none named; --operator NAME stores one with the run")
    assert words in plan_outcome(nobody).page.identity
    assert "Operator" not in dict(plan_outcome(somebody).page.identity)
    assert nobody.operator == ""
