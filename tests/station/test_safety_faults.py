"""Safety: whatever fails, every instrument is told to reach its safe state, and the run says what happened."""

import _thread
import threading

import pytest
from safety_runs import ROLES, SAFE, assert_safe, run

from cbsr_qa.domain.errors import AbortedError, InstrumentError
from cbsr_qa.domain.run.events import FramesTaken, LoadFinished, PhaseStarted, RunEnded, StepStarted
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.bench import stop_all
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, raising


def calls_of_a_good_run():
    """What a run calls between making the bench safe at its start and at its end."""
    ended, _, script, _ = run()
    assert ended.end is EndReason.FINISHED
    assert script.names()[: len(SAFE)] == script.names()[-len(SAFE) :] == SAFE
    return script.names()[len(SAFE) : -len(SAFE)]


GOOD = calls_of_a_good_run()

FAULTS = {
    "instrument": (
        lambda: InstrumentError("some_role", "COM3", "no answer"),
        EndReason.BROKEN,
        "instrument some_role at COM3: no answer, while",
    ),
    "bug": (
        lambda: ZeroDivisionError("in a driver"),
        EndReason.BROKEN,
        "failed: ZeroDivisionError: in a driver, while",
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
    script.do_at(len(SAFE) + number, raising(make()))
    ended, documents, script, bench = run(script=script)
    assert_safe(script, bench)
    called = script.names()[len(SAFE) : -len(SAFE)]
    assert called[: number + 1] == GOOD[: number + 1]
    # Nothing else is touched after the fault, but that a head somebody stopped in the sheet goes up as usual.
    lifts = reason is EndReason.ABORTED and "head down" in ended.detail
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


@pytest.mark.parametrize("error", [RuntimeError("can't start new thread"), MemoryError()])
def test_everybody_is_called_even_without_threads(error, monkeypatch):
    def no_thread(*given):
        raise error

    monkeypatch.setattr(_thread, "start_new_thread", no_thread)
    called = []
    assert stop_all([("a", lambda: called.append("a")), ("b", raising(OSError("x")))]) == ("b: OSError: x",)
    assert called == ["a"]


def test_a_thread_that_never_says_that_it_runs_keeps_nobody_from_their_safe_state(monkeypatch):
    """As where no memory is left: a new thread then ends before it can say anything."""
    begin = _thread.start_new_thread

    def lost(run, given):
        return 0 if run.__self__.who == "lost" else begin(run, given)

    monkeypatch.setattr(_thread, "start_new_thread", lost)
    called = []
    actions = [("lost", lambda: called.append("lost")), ("found", lambda: called.append("found"))]
    assert stop_all(actions, patience_s=0.01, deadline_s=0.1) == ("lost did not answer within 0.1 s",)
    assert called == ["found"]


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
