"""A first signal ends a run in order, a second at once; whoever hangs, the head comes up."""

import os
import signal
import threading
import time
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cbsr_qa.clock import RealClock, VirtualClock
from cbsr_qa.domain.errors import AbortedError, InstrumentError, RefusedError, SafetyError
from cbsr_qa.domain.loads import Load
from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.domain.plan import Motion
from cbsr_qa.domain.run_events import FramesTaken, LoadFinished, PhaseFinished, RunEnded, RunStarted, StepStarted
from cbsr_qa.domain.steps import AcquireFrames, Ease, FindSurface, Hold, MarkUnloaded, Press, Prompt, Release
from cbsr_qa.runner import interrupts, watchdog
from cbsr_qa.runner.asking import Asking
from cbsr_qa.runner.execute import execute
from cbsr_qa.runner.watchdog import Watchdog
from cbsr_qa.testing.bench import Script, example_identity, example_plan, raising, scripted_bench

LOAD = Load("L0", 0.0, 0.0, 0.2, 0)
CYCLE = (Press(LOAD), Hold(10, acquire=True), Release(), Hold(10, acquire=True))
ROLES = ("force_applicator", "frame_source", "load_cell")
SAFE = [f"{role}.safe_state" for role in ROLES]
ABORTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP, signal.SIGQUIT)
BY = {
    signal.SIGINT: "by the operator (Ctrl-C)",
    signal.SIGTERM: "by signal SIGTERM",
    signal.SIGHUP: "by signal SIGHUP",
    signal.SIGTSTP: "by signal SIGTSTP",
    signal.SIGQUIT: "by signal SIGQUIT",
}


@pytest.fixture(autouse=True)
def _as_at_a_terminal():
    """Signals as an interactive shell hands them down."""
    usual = dict.fromkeys(ABORTS, signal.SIG_DFL) | {signal.SIGINT: signal.default_int_handler}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def send(number, times=1):
    def act():
        for _ in range(times):
            os.kill(os.getpid(), number)

    return act


def run(steps=CYCLE, *, script=None, listeners=(), answer_s=60.0, motion=None, frame_period_s=2.5, **options):
    """Execute steps; return how it ended, the documents, the script, the bench and what was said at once."""
    script = script or Script(VirtualClock())
    plan = example_plan(steps)
    plan = replace(plan, safety=replace(plan.safety, answer_s=answer_s), motion=motion or plan.motion)
    bench = scripted_bench(script, plan.sensor_type, frame_period_s=frame_period_s)
    told, said = [], []
    subscribers = [told.append, *listeners]
    ended = execute(plan, example_identity(), bench, script.clock, subscribers, tell=said.append, **options)
    return ended, told, script, bench, said


def after(script, name, call=1):
    """Names of the calls after the n-th of a name."""
    places = [number for number, one in enumerate(script.names()) if one == name]
    return script.names()[places[call - 1] + 1 :]


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
    bench = scripted_bench(script, plan.sensor_type)
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
    assert line.startswith(f"{number.name}: the run stops in order.")
    assert "A second signal makes it safe at once." in line
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
    assert "; the head was not lifted in order: instrument force_applicator at COM3: stalled" in ended.detail
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
    assert "everything is made safe at once" in said[1]


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
    steps = (Press(LOAD), Hold(10, acquire=False), Ease(0.3), Hold(10, acquire=False), Release())
    looks = run(steps, script=script)[2].names()
    ease = [number for number, name in enumerate(looks) if name == "force_applicator.press"][1]
    script = Script(VirtualClock(), {"force_applicator.press": 3.0})
    script.at(ease - 1, send(signal.SIGTERM))
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
        with heard.heard():
            with pytest.raises(interrupts.Stopped, match="signal SIGTERM"):
                heard.poll()
            heard.poll()
            with pytest.raises(interrupts.Stopped):
                send(signal.SIGTERM)()
            send(signal.SIGTERM, 2)()
            heard.break_in(watchdog.BrokenInto(SafetyError("no answer", "too late")))
    assert (heard.urgent, len(said)) == (True, 2)


def test_nothing_is_broken_into_once_signals_are_masked():
    with interrupts.Interrupts(lambda line: None) as heard, heard.heard():
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
    bench = scripted_bench(script, plan.sensor_type)
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


# --- what hangs ------------------------------------------------------------------------------------------


def assert_made_safe(script):
    """Everybody was told after the last other call; on a busy computer the run and the watchdog may both have."""
    last = max(number for number, name in enumerate(script.names()) if name not in SAFE)
    assert set(script.names()[last + 1 :]) == set(SAFE)


@pytest.mark.parametrize("name", ["frame_source.acquire", "force_applicator.press", "load_cell.samples_since"])
def test_an_instrument_that_hangs_is_noticed_and_the_head_comes_up(name):
    script, never = Script(VirtualClock()), threading.Event()
    script.on(name, lambda: never.wait(30), call=2 if name.startswith("load") else 1)
    began = time.monotonic()
    motion = Motion(press_speed_mm_s=100.0, travel_speed_mm_s=1000.0, hover_mm=25.0)
    quick = {"motion": motion, "frame_period_s": 0.1}  # twice of what a call takes is allowed
    ended, told, script, bench, _ = run((*CYCLE, *CYCLE), script=script, answer_s=0.3, **quick)
    assert time.monotonic() - began < 15  # it would hang for 30
    assert ended.end is EndReason.BROKEN
    assert f"rule 'no answer': {name.partition('.')[0]} (scripted): " in ended.detail
    assert_made_safe(script)
    assert not bench.force_applicator.down
    assert told[-1] is ended
    never.set()


@pytest.mark.parametrize("retryable", [False, True])
def test_a_driver_that_makes_an_error_of_its_own_of_every_exception_does_not_hide_that_it_hung(retryable):
    script, never = Script(VirtualClock()), threading.Event()

    def hang():
        try:
            never.wait(30)
        except Exception as error:
            raise InstrumentError("load_cell", "COM3", "something", retryable=retryable) from error

    script.on("load_cell.samples_since", hang, call=2)
    ended, _, script, _, _ = run(script=script, answer_s=0.3)
    assert "rule 'no answer': load_cell (scripted): its samples has not come back for" in ended.detail
    assert script.count("load_cell.samples_since") == 2  # nobody is asked for anything any more
    assert_made_safe(script)


def test_a_driver_that_swallows_everything_is_stopped_at_its_next_call():
    script, never = Script(VirtualClock()), threading.Event()

    def hang():
        try:
            never.wait(30)
        except BaseException:  # noqa: BLE001 - what a bad driver does
            return

    script.on("load_cell.samples_since", hang, call=2)
    ended, _, script, _, _ = run(script=script, answer_s=0.3)
    assert "rule 'no answer'" in ended.detail
    assert_made_safe(script)


def test_what_cannot_be_broken_into_is_made_safe_without_it_and_said():
    """Outside of the main thread no signal arrives: the watchdog does it by itself, and the run ends broken."""
    script, late, results = Script(VirtualClock()), threading.Event(), []
    script.on("load_cell.samples_since", lambda: late.wait(30), call=2)

    def one():
        results.append(run(script=script, answer_s=0.3))

    thread = threading.Thread(target=one)
    thread.start()
    for _ in range(300):
        if script.names().count("load_cell.safe_state") == 2:  # the last to be told
            break
        time.sleep(0.05)
    assert_made_safe(script)  # while it still hangs
    late.set()
    thread.join(10)
    ended, told, script, bench, said = results[0]
    assert ended.end is EndReason.BROKEN
    assert "rule 'no answer': load_cell (scripted): its samples has not come back for" in ended.detail
    assert "the bench is made safe without it" in said[0]
    assert not bench.force_applicator.down
    assert told[-1] is ended


def test_a_call_may_take_twice_its_work_and_the_answer_time():
    late = []
    with Watchdog(0.3, break_in=late.append, make_safe=lambda: None, tell=lambda line: None) as dog:
        with dog.expect("a frame", 0.1):
            time.sleep(0.35)
        assert late == []
        with pytest.raises(SafetyError, match="a frame has not come back"), dog.expect("a frame", 0.1):
            time.sleep(1.5)
    assert len(late) == 1


def test_a_call_that_was_under_way_for_long_still_has_its_grace(monkeypatch):
    monkeypatch.setattr(watchdog, "GRACE_S", 0.6)
    late = []
    with Watchdog(1000.0, break_in=late.append, make_safe=lambda: None, tell=lambda line: None) as dog:
        with dog.expect("a frame"):
            time.sleep(0.8)
            dog.hurry()
            time.sleep(0.3)
        assert late == []
        with pytest.raises(SafetyError), dog.expect("a frame"):
            time.sleep(1.2)


def test_an_instrument_that_waits_for_the_operator_does_not_hang():
    asking = Asking(lambda text: time.sleep(1.0) or "done")
    script = Script(VirtualClock())
    script.on("load_cell.samples_since", lambda: asking("read the scale"), call=2)
    assert run(script=script, answer_s=0.3, ask=asking)[0].end is EndReason.FINISHED
    script.on("load_cell.samples_since", lambda: time.sleep(1.0), call=script.count("load_cell.samples_since") + 2)
    assert "rule 'no answer'" in run(script=script, answer_s=0.3, ask=asking)[0].detail


def test_a_prompt_may_take_as_long_as_it_takes():
    steps = (Prompt("turn it"), *CYCLE)
    assert run(steps, answer_s=0.3, ask=lambda text: time.sleep(1.0))[0].end is EndReason.FINISHED


@pytest.mark.parametrize("who", ["journal", "listener"])
def test_a_journal_or_a_listener_that_hangs_keeps_no_head_down(who):
    """A terminal that was stopped by Ctrl-S, a disk that is away."""
    never = threading.Event()

    def hang(event):
        if isinstance(event, FramesTaken):
            never.wait(30)

    script, plan = Script(VirtualClock()), example_plan(CYCLE)
    plan = replace(plan, safety=replace(plan.safety, answer_s=0.3))
    bench = scripted_bench(script, plan.sensor_type)
    told = []
    subscribers = [hang, told.append] if who == "journal" else [told.append, hang]
    ended = execute(plan, example_identity(), bench, script.clock, subscribers, tell=lambda line: None)
    assert ended.end is EndReason.BROKEN
    assert "rule 'no answer': the journal, or whoever listens, has not come back for" in ended.detail
    assert_made_safe(script)
    assert not bench.force_applicator.down


def test_a_wait_is_no_call_that_hangs():
    assert run((Hold(1.5, acquire=False),), script=Script(RealClock()), answer_s=0.3)[0].end is EndReason.FINISHED


def test_a_signal_ends_what_waits_for_the_operator_at_once():
    asking, never = Asking(lambda text: never.wait(30) and "done"), threading.Event()
    script = Script(VirtualClock())

    def wait():
        threading.Timer(0.2, send(signal.SIGINT)).start()
        asking("press to 0.8 mm")

    script.on("force_applicator.press", wait)
    began = time.monotonic()
    ended, _, script, _, _ = run(script=script, ask=asking)
    assert time.monotonic() - began < 15  # it would hang for 30
    assert ended.detail.startswith("by the operator (Ctrl-C), while pressing")
    assert not asking.is_waiting()
    assert after(script, "force_applicator.press") == SAFE


def test_a_signal_leaves_little_time_to_what_hangs(monkeypatch):
    monkeypatch.setattr(watchdog, "GRACE_S", 0.3)
    script, never = Script(VirtualClock()), threading.Event()

    def hang():
        send(signal.SIGTERM)()
        never.wait(30)

    script.on("load_cell.samples_since", hang, call=2)
    began = time.monotonic()
    ended, _, script, bench, _ = run(script=script, answer_s=1000.0)
    assert time.monotonic() - began < 15  # it would hang for 30
    assert ended.end is EndReason.BROKEN
    assert "rule 'no answer'" in ended.detail
    assert not bench.force_applicator.down


# --- whatever happens ------------------------------------------------------------------------------------

STEPS = (
    FindSurface(0, 0), Hold(6, acquire=False), MarkUnloaded(), AcquireFrames(2), *CYCLE, Press(LOAD), Ease(0.3),
    Hold(5, acquire=True), Release(), Hold(5, acquire=False),
)  # fmt: skip
TOOK_S = {
    "force_applicator.home": 6.0,
    "force_applicator.find_surface": 9.0,
    "force_applicator.move_to": 3.0,
    "force_applicator.press": 3.5,
    "force_applicator.release": 3.25,
}
NUMBER_OF_CALLS = len(run(STEPS, script=Script(VirtualClock(), TOOK_S))[2].calls)
ACTIONS = {
    "lost": lambda: raising(InstrumentError("some_role", "COM3", "no reply", retryable=True)),
    "broken": lambda: raising(InstrumentError("some_role", "COM3", "burnt")),
    "bug": lambda: raising(ZeroDivisionError("in a driver")),
    "interrupted": lambda: raising(KeyboardInterrupt()),
    "aborted": lambda: raising(AbortedError("the foreman")),
    "SIGINT": lambda: send(signal.SIGINT),
    "SIGTERM": lambda: send(signal.SIGTERM),
    "SIGHUP twice": lambda: send(signal.SIGHUP, 2),
}


@settings(max_examples=300, deadline=None)
@given(faults=st.dictionaries(st.integers(3, NUMBER_OF_CALLS + 3), st.sampled_from(sorted(ACTIONS)), max_size=5))
def test_whatever_happens_the_head_is_up_the_bench_safe_and_the_record_consistent(faults):
    """Faults at any calls, also in the safe state: every instrument is told it all the same, in its turn, at once."""
    script = Script(VirtualClock(), TOOK_S)
    for number, action in faults.items():
        script.at(number, ACTIONS[action]())
    ended, told, script, bench, _ = run(STEPS, script=script)
    names = script.names()
    assert names[-3:] == SAFE
    first_safe = len(names) - 3
    in_safe_state = {action for number, action in faults.items() if number >= first_safe}
    failed = in_safe_state & {"lost", "broken", "bug", "interrupted", "aborted"}
    assert ("NOT SAFE" in ended.detail) == bool(failed & {faults.get(first_safe + k) for k in range(3)})
    if faults.get(first_safe) not in failed:
        assert not bench.force_applicator.down
    assert_consistent(ended, told, script)
    before = [faults[number] for number in sorted(faults) if number < first_safe]
    if not before and "NOT SAFE" not in ended.detail:
        assert ended.end is EndReason.FINISHED


def assert_consistent(ended, told, script):
    """One first document, one last; times that do not go back; every press with its rest, or none."""
    assert [isinstance(one, RunStarted) for one in told].count(True) == isinstance(told[0], RunStarted)
    assert told[-1] is ended
    assert sum(isinstance(one, RunEnded) for one in told) == 1
    times = [one.time_s for one in told if isinstance(one, StepStarted | RunEnded)]
    assert times == sorted(times)
    assert sum(seconds for _, seconds in ended.spent) <= ended.time_s + 1e-6
    finished = [one.record for one in told if isinstance(one, LoadFinished)]
    assert [record.index for record in finished] == list(range(len(finished)))
    for record in finished:
        stamps = (record.press_start_s, record.hold_start_s, record.release_start_s, record.release_end_s)
        assert list(stamps) == sorted(stamps)
        assert record.rest_end_s >= record.release_end_s
    safe_s = [call.time_s for call in script.calls if call.name.endswith("safe_state")][-3:]
    last_s = max(call.time_s for call in script.calls if not call.name.endswith("safe_state"))
    # From the last thing that was asked of the bench, its own time included.
    assert max(safe_s) - last_s <= max(TOOK_S.values()) + 1.0
    if ended.end is EndReason.FINISHED:
        assert ended.detail == ""
    else:
        assert (
            "(phase 'phase 0', step" in ended.detail
            or "before the first step" in ended.detail
            or (ended.detail.startswith("NOT SAFE"))
        )
