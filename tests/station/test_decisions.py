"""Decisions between presses: by a scripted bench, what is pressed and when it ends; and what the dry run says."""

from dataclasses import dataclass, replace

import pytest

from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, Home, MarkUnloaded, Press, Release
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.events import LoadFinished, StepStarted
from cbsr_qa.domain.run.run import PressDecided
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.interfaces import PressGoal
from cbsr_qa.station.decisions import PressDecisions
from cbsr_qa.station.dry_runs import dry_run
from cbsr_qa.station.execution import execute
from cbsr_qa.station.plan import PlannedPhase, schedule, split_presses
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, example_identity, example_plan, make_scripted_bench

GOAL = PressGoal(0.1, 3, 4, 40.0, (0.05, 0.3), 0.8)


@dataclass(frozen=True)
class FivePlaces:
    """A sequence of five places, of which at most four are pressed."""

    goal: PressGoal = GOAL
    radius_mm: float = 20.0

    def steps(self, context):
        yield from (Hold(30.0, acquire=False), MarkUnloaded(), AcquireFrames(16))
        for number in range(5):
            x_mm = number * self.radius_mm / 4
            load = Load(f"A{number}", x_mm, 0.0, 0.2, 0)
            yield from (FindSurface(x_mm, 0.0), Press(load), Hold(10.0, acquire=True), Release())
            yield Hold(5.0, acquire=True)


def plan_with(sequence):
    return replace(example_plan([]), phases=(PlannedPhase("chosen", "five", sequence),))


class Told:
    """Decides as it is told, and notes of what it was asked."""

    def __init__(self, order, why="target"):
        self.order, self.why, self.events, self.begun = list(order), why, [], []

    def follow(self, event):
        self.events.append(event)

    def begin(self, identity, phase, pressed, last):
        self.begun.append((phase, pressed, None if last is None else last.load.label))

    def decide(self, time_s):
        _, pressed, _ = self.begun[-1]
        load = self.order[pressed] if pressed < len(self.order) else None
        label = "" if load is None else f"A{load}"
        made = PressDecided(
            phase=0, pressed=pressed, load=load, label=label, x_mm=None, y_mm=None, expected_N=None, upper_N=None,
            floor_N=None, why="start" if label else self.why, time_s=time_s,
        )  # fmt: skip
        return made, True


def run(plan, decider, **options):
    script = Script(VirtualClock())
    bench = make_scripted_bench(script, plan.sensor_type)
    events = []
    ended = execute(plan, example_identity(), bench, script.clock, [events.append], decider=decider, **options)
    return ended, events, script


def test_presses_are_those_decided_and_every_decision_is_an_event():
    decider = Told([3, 0, 4])
    ended, events, script = run(plan_with(FivePlaces()), decider)
    assert ended.end is EndReason.FINISHED
    assert [event.record.index for event in events if isinstance(event, LoadFinished)] == [3, 0, 4]
    made = [event for event in events if isinstance(event, PressDecided)]
    assert [(one.pressed, one.load, one.why) for one in made] == [
        (0, 3, "start"), (1, 0, "start"), (2, 4, "start"), (3, None, "target"),
    ]  # fmt: skip
    # Decided from the release on, while the sheet rests; the first from what earlier phases have.
    assert decider.begun == [(0, 0, None), (0, 1, "A3"), (0, 2, "A0"), (0, 3, "A4")]
    assert script.count("force_applicator.find_surface") == script.count("force_applicator.press") == 3


def test_a_decision_follows_the_press_it_rests_on():
    _, events, _ = run(plan_with(FivePlaces()), Told([1]))
    kinds = [type(event) for event in events]
    last_finished = max(number for number, kind in enumerate(kinds) if kind is LoadFinished)
    assert kinds[last_finished + 1] is PressDecided


def test_a_resumed_phase_rests_as_after_its_last_press_and_presses_none_again():
    plan = plan_with(FivePlaces())
    (phase,) = schedule(plan, ((0, 3), (0, 1)))
    before, presses = split_presses(phase.steps)
    assert [type(step.step) for step in before] == [Home, Hold, Hold]
    whole = {step.number: step for step in schedule(plan)[0].steps}
    assert (
        before[-1].number
        == next(n for n, step in whole.items() if step.load == 1 and isinstance(step.step, Release)) + 1
    )
    assert list(presses) == [0, 2, 4]
    decider = Told([3, 1, 2])
    _, events, _ = run(plan, decider, done=((0, 3), (0, 1)))
    assert decider.begun[0] == (0, 2, None)
    assert [event.record.index for event in events if isinstance(event, LoadFinished)] == [2]


def test_the_dry_run_takes_the_time_of_the_most_presses_and_checks_every_place():
    dry = dry_run(plan_with(FivePlaces()), 2.5)
    assert dry.loads == 4
    (phase,) = dry.phases
    assert phase.duration_with_s(3) < phase.duration_s == phase.duration_with_s(4)
    violations = dry_run(plan_with(FivePlaces(radius_mm=44.0)), 2.5).violations
    assert violations  # of the fifth place, which the most presses, in listed order, would not reach
    assert all("(44, 0)" in violation for violation in violations)


def test_the_time_left_is_that_of_the_dry_run_and_falls_to_none_when_it_ends_sooner():
    plan = plan_with(FivePlaces())
    _, events, _ = run(plan, Told([0, 1]))
    left_s = [event.remaining_s for event in events if isinstance(event, StepStarted)]
    assert left_s[0] == pytest.approx(dry_run(plan, 2.5).duration_s)
    assert left_s == sorted(left_s, reverse=True)


def test_a_phase_that_decides_must_calibrate():
    analysis = replace(load_recipe("adaptive").value.analysis, calibrate_phases=("another",))
    with pytest.raises(ConfigError, match="'chosen' decides by the force error of the calibration, and does not"):
        PressDecisions(plan_with(FivePlaces()), analysis, None)


def test_more_presses_than_places_are_refused():
    analysis = replace(load_recipe("adaptive").value.analysis, calibrate_phases=("chosen",))
    with pytest.raises(ConfigError, match="'chosen' may make 9 presses, and lists 5"):
        PressDecisions(plan_with(FivePlaces(replace(GOAL, at_most=9))), analysis, None)
