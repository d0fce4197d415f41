"""A first signal ends a run in order, a second at once; a plugin may stop it too."""

import signal
import threading
import time
from dataclasses import replace

import pytest
from stopping import ABORTS, BY, CYCLE, LOAD, ROLES, SAFE, after, dropped, run, send

from cbsr_qa.domain.errors import AbortedError, InstrumentError, RefusedError, SafetyError
from cbsr_qa.domain.plan.steps import Hold, Press, Prompt, Release, StrainStep
from cbsr_qa.domain.run.events import FramesTaken, LoadFinished, PhaseFinished, RunEnded, RunStarted
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station import interrupts, watchdog
from cbsr_qa.station.execution import execute
from cbsr_qa.system.clock import RealClock, VirtualClock
from cbsr_qa.testing.bench import Script, example_identity, example_plan, make_scripted_bench, raising

# --- the start -------------------------------------------------------------------------------------------


def test_the_bench_is_made_safe_before_anything_is_told_or_moved():
    script, told = Script(VirtualClock()), []
    for role in ROLES:
        script.on(f"{role}.safe_state", lambda: told.append("safe"))
    ended, documents, script, _, _ = run(script=script, listeners=[told.append])
    assert script.names()[:3] == SAFE
    assert told[:4] == ["safe", "safe", "safe", documents[0]]
    assert isinstance(documents[0], RunStarted)
    assert ended.end is EndReason.FINISHED


@pytest.mark.parametrize("role", ROLES)
def test_a_bench_that_cannot_be_made_safe_is_not_run(role):
    script, told = Script(VirtualClock()), []
    script.on(f"{role}.safe_state", raising(InstrumentError(role, "COM3", "no reply")))
    plan = example_plan(CYCLE)
    bench = make_scripted_bench(script, plan.sensor_type)
    with pytest.raises(SafetyError) as refused:
        execute(plan, example_identity(), bench, script.clock, [told.append])
    assert refused.value.rule == "safe start"
    assert f"{role} (scripted): InstrumentError: {role} at COM3: no reply" in refused.value.reason
    assert (script.names(), told) == (SAFE, [])


def test_what_is_refused_is_not_touched_and_a_signal_before_the_first_step_aborts():
    script = Script(VirtualClock())
    with pytest.raises(RefusedError):
        run((Press(replace(LOAD, strain=0.9)), Release()), script=script)
    assert script.calls == []
    script.on("frame_source.safe_state", send(signal.SIGTERM))
    ended, told, script, _, _ = run(script=script)
    assert script.names() == [*SAFE, *SAFE]
    assert (ended.end, [type(one) for one in told]) == (EndReason.ABORTED, [RunStarted, RunEnded])
    assert ended.detail == "by signal SIGTERM, before the first step"


# --- the first signal ------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", ABORTS)
def test_the_first_signal_completes_the_frame_and_lifts_the_head_as_after_any_press(number):
    script = Script(VirtualClock())
    script.on("frame_source.acquire", send(number), call=2)
    ended, told, script, bench, said = run(script=script)
    assert ended.end is EndReason.ABORTED
    assert ended.detail.startswith(f"{BY[number]}, while holding still for 10 s, taking frames (phase 'phase 0'")
    assert sum(isinstance(d, FramesTaken) for d in told) == 2
    assert after(script, "frame_source.acquire", 2) == ["force_applicator.release", *SAFE]
    assert not bench.force_applicator.down
    (line,) = said
    assert line.startswith(f"{number.name}: the run stops:")
    assert "A second signal makes the bench safe at once." in line
    assert not any(isinstance(d, LoadFinished | PhaseFinished) for d in told)
    assert told[-1] is ended


def test_a_press_under_way_is_completed_and_taken_back():
    script = Script(VirtualClock(), {"force_applicator.press": 3.0, "force_applicator.release": 3.0})
    script.on("force_applicator.press", send(signal.SIGTERM))
    ended, _, script, _, _ = run(script=script)
    rest = [name for name in after(script, "force_applicator.press") if not name.startswith("load_cell.samples")]
    assert rest == ["force_applicator.release", *SAFE]
    assert dict(ended.spent)["release"] == 3.0
    assert sum(seconds for _, seconds in ended.spent) == pytest.approx(ended.time_s)


@pytest.mark.parametrize("name", ["force_applicator.home", "force_applicator.move_to", "force_applicator.release"])
def test_a_head_that_is_up_stays_up(name):
    script = Script(VirtualClock())
    script.on(name, send(signal.SIGINT))
    ended, _, script, bench, _ = run(script=script)
    assert ended.end is EndReason.ABORTED
    rest = [one for one in after(script, name) if not one.startswith("load_cell.samples")]
    assert rest == SAFE
    assert not bench.force_applicator.down


def test_a_wait_is_ended_at_once():
    script = Script(RealClock())
    timer = threading.Timer(0.3, send(signal.SIGTERM))
    timer.start()
    began = time.monotonic()
    ended, *_ = run((Hold(60, acquire=False),), script=script)
    timer.join()
    assert ended.end is EndReason.ABORTED
    assert time.monotonic() - began < 15


def test_a_prompt_that_nobody_answers_is_ended_at_once():
    def ask(text):
        send(signal.SIGINT)()
        pytest.fail("somebody answered")

    ended, *_ = run((Prompt("turn it"), *CYCLE), ask=ask)
    assert ended.end is EndReason.ABORTED
    assert "by the operator (Ctrl-C), while asking: turn it" in ended.detail


def test_a_lift_that_fails_is_said_and_the_bench_made_safe_all_the_same():
    script = Script(VirtualClock())
    script.on("frame_source.acquire", send(signal.SIGTERM))
    script.on("force_applicator.release", raising(InstrumentError("force_applicator", "COM3", "stalled")))
    ended, _, script, bench, _ = run(script=script)
    assert ended.end is EndReason.ABORTED
    assert "by signal SIGTERM, while" in ended.detail
    assert "; lifting the head failed: instrument force_applicator at COM3: stalled" in ended.detail
    assert script.names()[-3:] == SAFE
    assert not bench.force_applicator.down


# --- the second signal -----------------------------------------------------------------------------------


def test_the_second_signal_makes_everything_safe_where_the_run_is():
    script = Script(VirtualClock())
    script.on("frame_source.acquire", send(signal.SIGINT, 2))
    ended, told, script, bench, said = run(script=script)
    assert ended.end is EndReason.ABORTED
    assert ended.detail.startswith("by the operator (Ctrl-C) and at once by a second signal, while holding")
    assert not any(isinstance(d, FramesTaken) for d in told)  # the frame was torn, and is not stored
    assert after(script, "frame_source.acquire") == SAFE
    assert not bench.force_applicator.down
    assert [line.split(":")[0] for line in said] == ["SIGINT", "SIGINT"]
    assert "making the bench safe at once" in said[1]


def test_the_second_signal_breaks_into_the_lift():
    script = Script(VirtualClock())
    script.on("frame_source.acquire", send(signal.SIGTERM))
    script.on("force_applicator.release", send(signal.SIGHUP))
    ended, _, script, bench, _ = run(script=script)
    assert ended.end is EndReason.ABORTED
    assert "by signal SIGTERM, while" in ended.detail
    assert ended.detail.endswith("; a second signal ended it at once")
    assert after(script, "force_applicator.release") == SAFE
    assert not bench.force_applicator.down


def test_the_second_signal_ends_what_hangs():
    script, never = Script(VirtualClock()), threading.Event()

    def hang():
        threading.Timer(0.2, send(signal.SIGTERM)).start()
        threading.Timer(0.4, send(signal.SIGTERM)).start()
        never.wait(30)

    script.on("frame_source.acquire", hang)
    began = time.monotonic()
    ended, _, script, bench, _ = run(script=script)
    assert time.monotonic() - began < 15  # it would hang for 30
    assert ended.end is EndReason.ABORTED
    assert script.names()[-3:] == SAFE
    assert not bench.force_applicator.down


@pytest.mark.parametrize("hears", ["frame_source.acquire", "force_applicator.press", "force_applicator.release"])
def test_a_third_signal_and_more_are_ignored_while_everything_is_made_safe(hears):
    script = Script(VirtualClock())
    script.on(hears, send(signal.SIGTERM, 2))
    for name in SAFE:
        script.on(name, send(signal.SIGTERM, 3), call=2)
    ended, told, script, bench, said = run(script=script)
    assert script.names()[-3:] == SAFE
    assert not bench.force_applicator.down
    assert (ended.end, told[-1] is ended, len(said)) == (EndReason.ABORTED, True, 2)


def test_a_head_that_is_about_to_be_eased_is_lifted_in_order():
    script = Script(VirtualClock(), {"force_applicator.press": 3.0})
    steps = (Press(LOAD), Hold(10, acquire=False), StrainStep(0.3), Hold(10, acquire=False), Release())
    looks = run(steps, script=script)[2].names()
    ease = [number for number, name in enumerate(looks) if name == "force_applicator.press"][1]
    script = Script(VirtualClock(), {"force_applicator.press": 3.0})
    script.do_at(ease - 1, send(signal.SIGTERM))
    _, _, script, _, _ = run(steps, script=script)
    assert script.count("force_applicator.press") == 1
    assert script.names()[ease:] == ["force_applicator.release", *SAFE]


def test_a_signal_while_a_finished_run_is_made_safe_changes_nothing_and_says_nothing():
    script = Script(VirtualClock())
    for name in SAFE:
        script.on(name, send(signal.SIGTERM), call=2)
    ended, _, _, _, said = run(script=script)
    assert (ended.end, ended.detail, said) == (EndReason.FINISHED, "", [])


def test_a_signal_is_raised_once_where_the_run_may_end():
    said = []
    with interrupts.Interrupts(said.append) as heard:
        send(signal.SIGTERM)()
        heard.poll()  # outside of what may be ended
        with heard.listen():
            with pytest.raises(interrupts.Stopped, match="signal SIGTERM"):
                heard.poll()
            heard.poll()
            with pytest.raises(interrupts.Stopped):
                send(signal.SIGTERM)()
            send(signal.SIGTERM, 2)()
            heard.break_in(watchdog.BrokenInto(SafetyError("no answer", "too late")))
    assert (heard.urgent_by, len(said)) == ("a second signal", 2)


def test_nothing_is_broken_into_once_signals_are_masked():
    with interrupts.Interrupts(lambda line: None) as heard, heard.listen():
        heard.mask()
        heard.break_in(watchdog.BrokenInto(SafetyError("no answer", "too late")))
        send(signal.SIGTERM)()
        heard.poll()


def test_signals_are_the_applications_again_after_the_run():
    before = [signal.getsignal(number) for number in (*ABORTS, signal.SIGALRM)]
    run()
    assert [signal.getsignal(number) for number in (*ABORTS, signal.SIGALRM)] == before


def test_what_is_said_reaches_stderr_past_all_buffers(capfd):
    script, plan = Script(VirtualClock()), example_plan(CYCLE)
    script.on("frame_source.acquire", send(signal.SIGTERM))
    bench = make_scripted_bench(script, plan.sensor_type)
    execute(plan, example_identity(), bench, script.clock, [lambda event: None])
    assert capfd.readouterr().err == interrupts.FIRST.format("SIGTERM") + "\n"


# --- a plugin stops the run ------------------------------------------------------------------------------


def test_a_listener_may_stop_the_run_in_order_and_says_who():
    def hook(event):
        if isinstance(event, FramesTaken):
            raise AbortedError("the plugin climate-watch")

    ended, told, script, _, _ = run(listeners=[hook])
    assert ended.end is EndReason.ABORTED
    assert ended.detail.startswith("by the plugin climate-watch, while holding still")
    assert after(script, "frame_source.acquire") == ["force_applicator.release", *SAFE]
    assert told[-1] is ended


def test_a_listener_that_stops_a_run_that_has_ended_changes_nothing():
    def hook(event):
        if isinstance(event, RunEnded):
            raise AbortedError("somebody late")

    assert run(listeners=[hook])[0].end is EndReason.FINISHED


# --- what Python drops -----------------------------------------------------------------------------------


@pytest.mark.parametrize("number", ABORTS)
def test_a_second_signal_that_python_dropped_still_ends_the_run_at_once(number):
    script = Script(VirtualClock())

    def press_twice_and_hang():
        send(number)()
        dropped(number, for_s=5.0)

    script.on("frame_source.acquire", press_twice_and_hang, call=2)
    began = time.monotonic()
    ended, _, script, _, said = run(script=script)
    assert time.monotonic() - began < 4.0
    assert (ended.end, after(script, "frame_source.acquire", 2)) == (EndReason.ABORTED, SAFE)
    assert len(said) == 2
