"""Safety: a run that leaves its limits of force, strain, travel or time, or is not told its force, is stopped."""

import numpy as np
import pytest
from safety_runs import LOAD, SHORT, assert_safe, run

from cbsr_qa.domain.errors import InstrumentError, SafetyError
from cbsr_qa.domain.plan.steps import FindSurface, Hold, Press, Release, StrainStep
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.interrupts import Interrupts
from cbsr_qa.station.limits import Limits
from cbsr_qa.station.performer import Performer
from cbsr_qa.station.plan import ScheduledStep
from cbsr_qa.station.safety import Interlock, UnderWay
from cbsr_qa.station.watchdog import Watchdog
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, example_plan, make_scripted_bench, raising


def test_force_above_the_ceiling_stops_with_the_evidence_stored():
    script = Script(VirtualClock(), force_N=lambda t, down: 21.0 if down else 0.0)
    ended, documents, script, bench = run(script=script)
    assert_safe(script, bench)
    assert ended.end is EndReason.BROKEN
    assert "rule 'force': 21 N measured by load_cell (scripted); the station allows 20 N" in ended.detail
    stored = [d.samples.values.max() for d in documents if type(d).__name__ == "SamplesTaken"]
    assert max(stored) == 21.0
    # The first samples after the head came down decide; the hold's second frame is never taken.
    assert script.count("frame_source.acquire") == 3


@pytest.mark.parametrize(
    ("force_N", "said"),
    [(-21.0, "rule 'force'"), (float("nan"), "rule 'force'"), (float("inf"), "channel force: the value of sample 0")],
)
def test_pull_and_nonsense_stop_as_push_does(force_N, said):
    ended, _, script, bench = run(script=Script(VirtualClock(), force_N=lambda t, down: force_N))
    assert_safe(script, bench)
    assert ended.end is EndReason.BROKEN
    assert said in ended.detail


def test_a_load_cell_may_be_silent_while_nothing_is_pressed():
    steps = (Hold(600, acquire=True),)
    ended, *_ = run(steps, script=Script(VirtualClock(), force_N=lambda t, down: None))
    assert ended.end is EndReason.FINISHED


SEARCH = (Hold(60, acquire=False), FindSurface(0, 0), Hold(60, acquire=False))
EASED = (Press(LOAD), Hold(30, acquire=False), StrainStep(0.3), Hold(30, acquire=False), Release())
SEARCHING, PRESSING = {"force_applicator.find_surface": 9.0}, {"force_applicator.press": 3.0}


def silent_from(at_s, force_N=0.0):
    return lambda t, down: force_N if t < at_s else None


def too_high_at(at_s, otherwise_N):
    return lambda t, down: 21.0 if at_s < t < at_s + 1 else otherwise_N


#: Steps, how long calls take, the force; the rule that is broken, what is said of the head, how often it was moved,
#: and when the run ended.
STOPPED = {
    "silent under load": (
        SHORT, {}, lambda t, down: None if down else 0.0, "stale force", "head down", {"press": 1}, None
    ),
    "silent in a hold without frames": (
        (Press(LOAD), Hold(3600, acquire=False), Release()), {}, silent_from(20, 1.0), "stale force", "", {}, 22.0
    ),
    "overstaying": (SHORT, {"force_applicator.find_surface": 13 * 3600}, None, "duration", "", {}, None),
    "silent before the search": (
        SEARCH, {}, lambda t, down: None, "stale force", "head searching the surface", {"find_surface": 0}, None
    ),
    "silent during the search": (SEARCH, SEARCHING, silent_from(61), "stale force", "", {"find_surface": 1}, 69.0),
    "too high during the search": (
        SEARCH, SEARCHING, too_high_at(64, 0.0), "force': 21 N measured", "head searching the surface", {}, None
    ),
    "silent before a press": (
        (Hold(60, acquire=False), Press(LOAD), Release()), {}, silent_from(30), "stale force", "", {"press": 0}, None
    ),
    "silent before an ease": (EASED, PRESSING, silent_from(31, 1.0), "stale force", "head down", {"press": 1}, None),
    "too high during an ease": (
        EASED, PRESSING, too_high_at(34, 1.0), "force': 21 N measured", "", {"press": 2}, 36.0
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("steps", "took_s", "force_N", "rule", "head", "moved", "end_s"), STOPPED.values(), ids=STOPPED
)
def test_a_force_that_is_too_high_or_not_known_and_a_run_too_long_are_stopped(
    steps, took_s, force_N, rule, head, moved, end_s
):
    """What fails during a movement ends the run right after it, not at the next look."""
    script = Script(VirtualClock(), took_s, **({} if force_N is None else {"force_N": force_N}))
    ended, _, script, bench = run(steps, script=script)
    assert_safe(script, bench)
    assert ended.end is EndReason.BROKEN
    assert f"rule '{rule}" in ended.detail
    assert head in ended.detail
    assert {name: script.count(f"force_applicator.{name}") for name in moved} == moved
    if end_s is not None:
        assert ended.time_s == pytest.approx(end_s)


def test_an_ease_that_fails_is_not_tried_again():
    """Nobody knows how deep the head is; the first press goes well."""
    script = Script(VirtualClock())
    failed = InstrumentError("force_applicator", "COM3", "lost", retryable=True)
    script.on("force_applicator.press", raising(failed), call=2)
    ended, _, script, bench = run(EASED, script=script)
    assert_safe(script, bench)
    assert script.count("force_applicator.press") == 2
    assert "going to 30 %" in ended.detail
    assert "head changing its depth" in ended.detail


def test_the_runner_holds_an_ease_against_the_limits_of_a_press():
    """The dry run refuses it first; here the step comes as if it had not been looked at."""
    for bad, rule in ((0.36, "strain"), (0.0, "strain"), (float("nan"), "strain")):
        script = Script(VirtualClock())
        plan = example_plan(EASED)
        bench = make_scripted_bench(script, plan.sensor_type)
        interlock = Interlock()
        interlock.clear(bench)
        run = UnderWay(plan, bench, script.clock, _Nobody(), interlock, Interrupts(), _watchdog())
        performer = Performer(run, retries=0, ask=None)
        performer.perform(ScheduledStep(0, 0, Press(LOAD), 0))
        with pytest.raises(SafetyError) as broken:
            performer.perform(ScheduledStep(0, 1, StrainStep(bad), 0))
        assert broken.value.rule == rule
        assert script.count("force_applicator.press") == 1


class _Nobody:
    def emit(self, event):
        pass


def _watchdog(answer_s=60.0):
    return Watchdog(answer_s, break_in=lambda error: None, make_safe=lambda: None, tell=lambda line: None)


def test_the_runner_checks_again_what_the_dry_run_checked():
    limits = Limits(example_plan([]), 0.0)
    for bad, rule in ((Load("A", 0, 0, 0.36, 0), "strain"), (Load("A", 43, 0, 0.2, 0), "travel")):
        with pytest.raises(SafetyError) as broken:
            limits.check_load(bad)
        assert broken.value.rule == rule
    with pytest.raises(SafetyError):
        limits.check_place(float("nan"), 0.0)
    limits.check_load(LOAD)


def test_only_the_force_channel_is_held_against_the_ceiling():
    limits = Limits(example_plan([]), 0.0)
    limits.check_samples(SampleBlock("temperature", "°C", np.array([1.0]), np.array([25.0])), "a thermometer")
    with pytest.raises(SafetyError, match="measured by a cell"):
        limits.check_samples(SampleBlock("force", "N", np.array([1.0]), np.array([25.0])), "a cell")
