"""Safety: a run that leaves its limits of force, strain, travel or time, or is not told its force, is stopped."""

import numpy as np
import pytest
from safety_runs import LOAD, assert_safe, run

from cbsr_qa.domain import InstrumentError, SafetyError
from cbsr_qa.domain.plan import FindSurface, Hold, Press, Release, StrainStep
from cbsr_qa.domain.readings import SampleBlock
from cbsr_qa.domain.results import EndReason
from cbsr_qa.domain.run import Load
from cbsr_qa.station.interrupts import Interrupts
from cbsr_qa.station.limits import Limits
from cbsr_qa.station.performer import Performer
from cbsr_qa.station.plan import ScheduledStep
from cbsr_qa.station.safety import Interlock, UnderWay
from cbsr_qa.station.watchdog import Watchdog
from cbsr_qa.system import VirtualClock
from cbsr_qa.testing import Script, example_plan, raising, scripted_bench


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


def test_a_load_cell_that_falls_silent_under_load_stops_the_run():
    script = Script(VirtualClock(), force_N=lambda t, down: None if down else 0.0)
    ended, _, script, bench = run(script=script)
    assert_safe(script, bench)
    assert "rule 'stale force'" in ended.detail
    assert "head down" in ended.detail


def test_a_load_cell_may_be_silent_while_nothing_is_pressed():
    steps = (Hold(600, acquire=True),)
    ended, *_ = run(steps, script=Script(VirtualClock(), force_N=lambda t, down: None))
    assert ended.end is EndReason.FINISHED


def test_silence_is_noticed_within_a_hold_without_frames():
    script = Script(VirtualClock(), force_N=lambda t, down: 1.0 if t < 20 else None)
    ended, _, script, bench = run((Press(LOAD), Hold(3600, acquire=False), Release()), script=script)
    assert_safe(script, bench)
    assert "rule 'stale force'" in ended.detail
    assert ended.time_s < 20 + 2.0 + 1.0 + 0.1  # when it fell silent, the allowed age, one look


def test_a_run_that_overstays_is_stopped():
    script = Script(VirtualClock(), {"force_applicator.find_surface": 13 * 3600})
    ended, _, script, bench = run(script=script)
    assert_safe(script, bench)
    assert "rule 'duration'" in ended.detail


SEARCH = (Hold(60, acquire=False), FindSurface(0, 0), Hold(60, acquire=False))


def test_the_surface_is_not_searched_for_without_a_live_load_cell():
    ended, _, script, bench = run(SEARCH, script=Script(VirtualClock(), force_N=lambda t, down: None))
    assert_safe(script, bench)
    assert "rule 'stale force'" in ended.detail
    assert "head searching the surface" in ended.detail
    assert script.count("force_applicator.find_surface") == 0


def test_a_load_cell_that_falls_silent_during_the_search_stops_the_run():
    script = Script(
        VirtualClock(), {"force_applicator.find_surface": 9.0}, force_N=lambda t, down: 0.0 if t < 61 else None
    )
    ended, _, script, bench = run(SEARCH, script=script)
    assert_safe(script, bench)
    assert "rule 'stale force'" in ended.detail
    assert script.count("force_applicator.find_surface") == 1
    assert ended.time_s == pytest.approx(69.0)  # right after the search, not at the next look


def test_too_much_force_during_the_search_stops_the_run():
    script = Script(
        VirtualClock(), {"force_applicator.find_surface": 9.0}, force_N=lambda t, down: 21.0 if 64 < t < 65 else 0.0
    )
    ended, _, script, bench = run(SEARCH, script=script)
    assert_safe(script, bench)
    assert "rule 'force': 21 N measured" in ended.detail
    assert "head searching the surface" in ended.detail


def test_the_head_does_not_go_down_on_a_load_cell_that_has_fallen_silent():
    script = Script(VirtualClock(), force_N=lambda t, down: 0.0 if t < 30 else None)
    ended, _, script, bench = run((Hold(60, acquire=False), Press(LOAD), Release()), script=script)
    assert_safe(script, bench)
    assert "rule 'stale force'" in ended.detail
    assert script.count("force_applicator.press") == 0


EASED = (Press(LOAD), Hold(30, acquire=False), StrainStep(0.3), Hold(30, acquire=False), Release())


def test_a_head_is_not_eased_on_a_load_cell_that_has_fallen_silent():
    script = Script(VirtualClock(), {"force_applicator.press": 3.0}, force_N=lambda t, down: 1.0 if t < 31 else None)
    ended, _, script, bench = run(EASED, script=script)
    assert_safe(script, bench)
    assert "rule 'stale force'" in ended.detail
    assert "head down" in ended.detail
    assert script.count("force_applicator.press") == 1


def test_too_much_force_while_the_head_is_eased_deeper_stops_the_run():
    script = Script(
        VirtualClock(), {"force_applicator.press": 3.0}, force_N=lambda t, down: 21.0 if 34 < t < 35 else 1.0
    )
    ended, _, script, bench = run(EASED, script=script)
    assert_safe(script, bench)
    assert "rule 'force': 21 N measured" in ended.detail
    assert script.count("force_applicator.press") == 2
    assert ended.time_s == pytest.approx(36.0)  # right after it, not at the next look


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
        bench = scripted_bench(script, plan.sensor_type)
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
