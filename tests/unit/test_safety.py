"""Safety: whatever fails, every instrument is told to reach its safe state, and the run says what happened."""

import os
import signal
import threading

import numpy as np
import pytest

from cbsr_qa.clock import VirtualClock
from cbsr_qa.domain.errors import AbortedError, InstrumentError, SafetyError
from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.loads import Load
from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.domain.run_events import FramesTaken, LoadFinished, PhaseStarted, RunEnded, StepStarted
from cbsr_qa.domain.steps import AcquireFrames, Ease, FindSurface, Hold, MarkUnloaded, Press, Release
from cbsr_qa.runner.execute import execute
from cbsr_qa.runner.interrupts import Interrupts, Stopped
from cbsr_qa.runner.limits import Limits
from cbsr_qa.runner.performing import Performer
from cbsr_qa.runner.safety import TRANSITIONS, Interlock, State
from cbsr_qa.runner.schedule import ScheduledStep
from cbsr_qa.runner.stopping import stop_all
from cbsr_qa.runner.watchdog import Watchdog
from cbsr_qa.testing.bench import Script, example_identity, example_plan, raising, scripted_bench

LOAD = Load("L0", 0.0, 0.0, 0.2, 0)
SHORT = (
    FindSurface(0, 0),
    Hold(6, acquire=False),
    MarkUnloaded(),
    AcquireFrames(2),
    Press(LOAD),
    Hold(5, acquire=True),
    Hold(2, acquire=False),
    Ease(0.3),
    Hold(5, acquire=True),
    Ease(0.1),
    Hold(2, acquire=False),
    Release(),
    Hold(5, acquire=True),
)
ROLES = ("force_applicator", "frame_source", "load_cell")


def run(steps=SHORT, *, script=None, listeners=()):
    script = script or Script(VirtualClock())
    plan = example_plan(steps)
    bench = scripted_bench(script, plan.sensor_type)
    documents = []
    ended = execute(plan, example_identity(), bench, script.clock, [documents.append, *listeners])
    return ended, documents, script, bench


SAFE = [f"{role}.safe_state" for role in ROLES]


def calls_of_a_good_run():
    """What a run calls between making the bench safe at its start and at its end."""
    ended, _, script, _ = run()
    assert ended.end is EndReason.FINISHED
    assert script.names()[: len(SAFE)] == script.names()[-len(SAFE) :] == SAFE
    return script.names()[len(SAFE) : -len(SAFE)]


GOOD = calls_of_a_good_run()


def assert_safe(script, bench):
    """Every instrument was told to reach its safe state, after everything else, and the head is up."""
    assert script.names()[-len(SAFE) :] == SAFE
    assert not bench.force_applicator.down


# --- a fault at every step -------------------------------------------------------------------------------

FAULTS = {
    "instrument": (
        lambda: InstrumentError("some_role", "COM3", "no answer"),
        EndReason.BROKEN,
        "instrument some_role at COM3: no answer, while",
    ),
    "bug": (
        lambda: ZeroDivisionError("in a driver"),
        EndReason.BROKEN,
        "error ZeroDivisionError: in a driver, while",
    ),
    "ctrl-c": (KeyboardInterrupt, EndReason.ABORTED, "by the operator (Ctrl-C)"),
    "abort": (lambda: AbortedError("the foreman"), EndReason.ABORTED, "by the foreman"),
    "exit": (SystemExit, EndReason.BROKEN, "SystemExit"),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("number", range(len(GOOD)))
def test_a_fault_at_any_call_ends_safe_and_says_where(number, fault):
    make, reason, said = FAULTS[fault]
    script = Script(VirtualClock())
    script.at(len(SAFE) + number, raising(make()))
    ended, documents, script, bench = run(script=script)
    assert_safe(script, bench)
    called = script.names()[len(SAFE) : -len(SAFE)]
    assert called[: number + 1] == GOOD[: number + 1]
    # Nothing else is touched after the fault, but that a head somebody stopped in the sheet goes up as usual.
    lifts = reason is EndReason.ABORTED and "bench pressed" in ended.detail
    assert called[number + 1 :] == (["force_applicator.release"] if lifts else [])
    assert ended.end is reason
    assert said in ended.detail
    last = [d for d in documents if isinstance(d, StepStarted)][-1]
    assert f"step {last.number}" in ended.detail
    assert "phase 0" in ended.detail
    assert documents[-1] is ended
    assert sum(isinstance(d, RunEnded) for d in documents) == 1


@pytest.mark.parametrize("kind", [PhaseStarted, StepStarted, FramesTaken, LoadFinished])
def test_an_abort_by_a_listener_ends_safe(kind):
    def pressed_stop(event):
        if isinstance(event, kind):
            raise KeyboardInterrupt

    ended, documents, script, bench = run(listeners=[pressed_stop])
    assert_safe(script, bench)
    assert ended.end is EndReason.ABORTED
    assert any(isinstance(d, kind) for d in documents)


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("begun_by", ["a fault", "the end"])
def test_a_safe_state_that_raises_keeps_nobody_from_theirs(role, begun_by):
    script = Script(VirtualClock())
    script.on(f"{role}.safe_state", raising(OSError("cable pulled")), call=2)
    if begun_by == "a fault":
        script.on("force_applicator.press", raising(InstrumentError("force_applicator", "COM3", "stalled")))
    ended, _, script, _ = run(script=script)
    assert script.names()[-3:] == [f"{r}.safe_state" for r in ROLES]
    assert ended.end is EndReason.BROKEN
    assert f"NOT SAFE: {role} (scripted): OSError: cable pulled" in ended.detail
    assert ("stalled" in ended.detail) == (begun_by == "a fault")


def test_a_safe_state_that_hangs_keeps_nobody_from_theirs():
    release = threading.Event()
    script = Script(VirtualClock())
    script.on("force_applicator.safe_state", release.wait, call=2)
    ended, documents, script, _ = run(script=script)
    release.set()
    assert script.names()[-len(SAFE) :] == SAFE
    assert ended.end is EndReason.BROKEN
    assert "force_applicator (scripted) did not answer within 2 s" in ended.detail
    assert documents[-1] is ended


def test_everybody_is_called_even_without_threads(monkeypatch):
    def no_thread(self):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", no_thread)
    called = []
    assert stop_all([("a", lambda: called.append("a")), ("b", raising(OSError("x")))]) == ("b: OSError: x",)
    assert called == ["a"]


# --- limits ----------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("force_N", [-21.0, float("nan"), float("inf")])
def test_pull_and_nonsense_stop_as_push_does(force_N):
    ended, _, script, bench = run(script=Script(VirtualClock(), force_N=lambda t, down: force_N))
    assert_safe(script, bench)
    assert "rule 'force'" in ended.detail


def test_a_load_cell_that_falls_silent_under_load_stops_the_run():
    script = Script(VirtualClock(), force_N=lambda t, down: None if down else 0.0)
    ended, _, script, bench = run(script=script)
    assert_safe(script, bench)
    assert "rule 'stale force'" in ended.detail
    assert "bench pressed" in ended.detail


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
    assert "bench feeling" in ended.detail
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
    assert "bench feeling" in ended.detail


def test_the_head_does_not_go_down_on_a_load_cell_that_has_fallen_silent():
    script = Script(VirtualClock(), force_N=lambda t, down: 0.0 if t < 30 else None)
    ended, _, script, bench = run((Hold(60, acquire=False), Press(LOAD), Release()), script=script)
    assert_safe(script, bench)
    assert "rule 'stale force'" in ended.detail
    assert script.count("force_applicator.press") == 0


EASED = (Press(LOAD), Hold(30, acquire=False), Ease(0.3), Hold(30, acquire=False), Release())


def test_a_head_is_not_eased_on_a_load_cell_that_has_fallen_silent():
    script = Script(VirtualClock(), {"force_applicator.press": 3.0}, force_N=lambda t, down: 1.0 if t < 31 else None)
    ended, _, script, bench = run(EASED, script=script)
    assert_safe(script, bench)
    assert "rule 'stale force'" in ended.detail
    assert "bench pressed" in ended.detail
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
    assert "easing to 30 %" in ended.detail
    assert "bench easing" in ended.detail


def test_the_runner_holds_an_ease_against_the_limits_of_a_press():
    """The dry run refuses it first; here the step comes as if it had not been looked at."""
    for bad, rule in ((0.36, "strain"), (0.0, "strain"), (float("nan"), "strain")):
        script = Script(VirtualClock())
        plan = example_plan(EASED)
        bench = scripted_bench(script, plan.sensor_type)
        interlock = Interlock()
        interlock.clear(bench)
        watchers = {"interrupts": Interrupts(), "watchdog": _watchdog()}
        performer = Performer(plan, bench, script.clock, _Nobody(), interlock, **watchers, retries=0, ask=None)
        performer.perform(ScheduledStep(0, 0, Press(LOAD), 0))
        with pytest.raises(SafetyError) as broken:
            performer.perform(ScheduledStep(0, 1, Ease(bad), 0))
        assert broken.value.rule == rule
        assert script.count("force_applicator.press") == 1


class _Nobody:
    def emit(self, event):
        pass


def _watchdog(answer_s=60.0):
    return Watchdog(answer_s, break_in=lambda error: None, make_safe=lambda: None, tell=lambda line: None)


# --- the state machine -----------------------------------------------------------------------------------


def test_every_state_can_be_stopped_from_and_only_stopping_ends():
    for state, following in TRANSITIONS.items():
        ends = state in (State.STOPPING, State.SAFE, State.UNSAFE)
        assert (State.STOPPING in following) != ends
        assert bool(following & {State.SAFE, State.UNSAFE}) == (state is State.STOPPING)
    assert set(TRANSITIONS) == set(State)


def test_no_way_leads_from_a_touching_state_to_travel_but_through_release():
    for state in (State.PRESSING, State.PRESSED, State.EASING):
        assert not TRANSITIONS[state] & {State.ARMED, State.MOVING}
    assert State.MOVING not in TRANSITIONS[State.RELEASING]


def test_a_head_is_eased_from_where_it_is_pressed_and_nowhere_else():
    assert [state for state, following in TRANSITIONS.items() if State.EASING in following] == [State.PRESSED]
    assert TRANSITIONS[State.EASING] == {State.PRESSED, State.STOPPING}
    interlock = Interlock()
    interlock.state = State.EASING
    assert interlock.touching
    assert interlock.dwelling


@pytest.mark.parametrize("state", list(State))
def test_transitions_that_are_not_listed_are_refused(state):
    interlock = Interlock()
    interlock.state = state
    for other in set(State) - TRANSITIONS[state]:
        with pytest.raises(SafetyError, match=f"is {state}"):
            interlock.to(other)


def test_an_error_leaves_the_state_it_happened_in():
    interlock = Interlock()
    interlock.to(State.CLEARING)
    interlock.to(State.ARMED)
    with pytest.raises(OSError, match="x"), interlock.passing(State.PRESSING, State.PRESSED):
        raise OSError("x")
    assert interlock.state is State.PRESSING
    assert interlock.touching


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


# --- signals ---------------------------------------------------------------------------------------------


@pytest.fixture
def as_at_a_terminal():
    """Signals as an interactive shell hands them down: under nohup or ``&`` some are inherited as ignored."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def send(number):
    return lambda: os.kill(os.getpid(), number)


@pytest.mark.usefixtures("as_at_a_terminal")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_signal_inherited_as_ignored_stays_ignored(number):
    signal.signal(number, signal.SIG_IGN)
    script = Script(VirtualClock())
    script.on("force_applicator.press", send(number))
    ended, *_ = run(script=script)
    assert ended.end is EndReason.FINISHED
    assert signal.getsignal(number) is signal.SIG_IGN


@pytest.mark.usefixtures("as_at_a_terminal")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_without_a_handler_aborts_by_its_name(number):
    script = Script(VirtualClock())
    script.on("force_applicator.press", send(number))
    before = signal.getsignal(number)
    ended, _, script, bench = run(script=script)
    assert_safe(script, bench)
    assert ended.end is EndReason.ABORTED
    assert f"by signal {number.name}" in ended.detail
    assert signal.getsignal(number) is before


@pytest.mark.usefixtures("as_at_a_terminal")
def test_the_application_may_say_who_aborted(monkeypatch):
    def handler(number, frame):
        raise AbortedError("the page's stop button")

    before = signal.signal(signal.SIGTERM, handler)
    try:
        script = Script(VirtualClock())
        script.on("frame_source.acquire", send(signal.SIGTERM))
        ended, *_ = run(script=script)
        assert "by the page's stop button" in ended.detail
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.usefixtures("as_at_a_terminal")
def test_an_impatient_second_ctrl_c_does_not_keep_the_head_down():
    script = Script(VirtualClock())
    script.on("force_applicator.press", send(signal.SIGINT))
    for role in ROLES:
        script.on(f"{role}.safe_state", send(signal.SIGINT), call=2)
    ended, documents, script, bench = run(script=script)
    assert_safe(script, bench)
    assert ended.end is EndReason.ABORTED
    assert documents[-1] is ended


@pytest.mark.usefixtures("as_at_a_terminal")
def test_a_signal_waits_until_the_journal_has_stored():
    stored = []

    def journal(event):
        if isinstance(event, FramesTaken) and not any(isinstance(e, FramesTaken) for e in stored):
            os.kill(os.getpid(), signal.SIGINT)
        stored.append(event)  # reached: the signal did not tear this apart

    script = Script(VirtualClock())
    plan = example_plan(SHORT)
    bench = scripted_bench(script, plan.sensor_type)
    ended = execute(plan, example_identity(), bench, script.clock, [journal])
    assert ended.end is EndReason.ABORTED
    assert sum(isinstance(e, FramesTaken) for e in stored) == 1
    assert_safe(script, bench)


@pytest.mark.usefixtures("as_at_a_terminal")
def test_a_second_signal_breaks_through_a_delivery_that_hangs():
    reached = []

    def hang(interrupts):
        with interrupts.heard(), interrupts.deferred():
            os.kill(os.getpid(), signal.SIGTERM)
            reached.append("after the first signal")
            os.kill(os.getpid(), signal.SIGTERM)
            reached.append("after the second signal")

    with Interrupts() as interrupts, pytest.raises(Stopped, match="SIGTERM"):
        hang(interrupts)
    assert reached == ["after the first signal"]


def test_a_run_outside_the_main_thread_is_safe_too():
    results = []
    script = Script(VirtualClock())
    script.on("force_applicator.press", raising(InstrumentError("force_applicator", "COM3", "stalled")))
    thread = threading.Thread(target=lambda: results.append(run(script=script)))
    thread.start()
    thread.join()
    ended, _, script, bench = results[0]
    assert_safe(script, bench)
    assert ended.end is EndReason.BROKEN
