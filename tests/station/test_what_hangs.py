"""Whoever hangs, the watchdog notices, the head comes up, and the run says who it was."""

import signal
import threading
import time
from dataclasses import replace
from queue import Queue

import pytest
from stopping import CYCLE, SAFE, after, assert_made_safe, run, send

from cbsr_qa.domain.errors import InstrumentError, SafetyError
from cbsr_qa.domain.plan.plan import Motion
from cbsr_qa.domain.plan.steps import Hold, Prompt
from cbsr_qa.domain.run.events import FramesTaken
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station import watchdog
from cbsr_qa.station.execution import execute
from cbsr_qa.station.prompts import OperatorPrompt
from cbsr_qa.station.watchdog import Watchdog
from cbsr_qa.system.clock import RealClock, VirtualClock
from cbsr_qa.testing.bench import Script, example_identity, example_plan, make_scripted_bench


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


def reported(*, retryable):
    def report(error):
        raise InstrumentError("load_cell", "COM3", "something", retryable=retryable) from error

    return report


@pytest.mark.parametrize(
    "reacts",
    [reported(retryable=False), reported(retryable=True), lambda error: None],
    ids=["an error of its own", "one to be tried again", "nothing"],
)
def test_a_driver_that_makes_something_of_every_exception_does_not_hide_that_it_hung(reacts):
    script, never = Script(VirtualClock()), threading.Event()

    def hang():
        try:
            never.wait(30)
        except BaseException as error:  # noqa: BLE001 - what a bad driver does
            reacts(error)

    script.on("load_cell.samples_since", hang, call=2)
    ended, _, script, _, _ = run(script=script, answer_s=0.3)
    assert "rule 'no answer': load_cell (scripted): reading its samples has not returned for" in ended.detail
    assert script.count("load_cell.samples_since") == 2  # nobody is asked for anything any more
    assert_made_safe(script)


def test_what_cannot_be_broken_into_is_made_safe_without_it_and_said():
    """Outside of the main thread no signal arrives: the watchdog does it by itself, and the run ends broken."""
    script, late, told_safe, results = Script(VirtualClock()), threading.Event(), threading.Event(), []
    script.on("load_cell.samples_since", lambda: late.wait(30), call=2)
    script.on("load_cell.safe_state", told_safe.set, call=2)  # the last to be told

    def one():
        results.append(run(script=script, answer_s=0.3))

    thread = threading.Thread(target=one)
    thread.start()
    assert told_safe.wait(15)
    assert_made_safe(script)  # while it still hangs
    late.set()
    thread.join(10)
    ended, told, script, bench, said = results[0]
    assert ended.end is EndReason.BROKEN
    assert "rule 'no answer': load_cell (scripted): reading its samples has not returned for" in ended.detail
    assert "the bench is made safe without it" in said[0]
    assert not bench.force_applicator.down
    assert told[-1] is ended


class PutForward:
    """The watchdog's clock, put forward by hand: nothing is late because the computer is busy."""

    def __init__(self):
        self._now_s = 0.0
        self._looks = 0
        self._looked = threading.Condition()

    def now(self):
        with self._looked:
            if threading.current_thread().name == "watchdog":
                self._looks += 1
                self._looked.notify_all()
            return self._now_s

    def put_forward(self, seconds):
        with self._looked:
            self._now_s += seconds

    def nothing_late_after(self, seconds):
        """Put forward; the watchdog has looked after it and looks again: one that ends a call does not."""
        self.put_forward(seconds)
        with self._looked:
            until = self._looks + 5
            assert self._looked.wait_for(lambda: self._looks >= until, timeout=15), "it looks no more"

    def late_after(self, seconds, late):
        """Put forward, and wait until somebody was broken into."""
        self.put_forward(seconds)
        late.get(timeout=15)


@pytest.fixture
def clock(monkeypatch):
    clock = PutForward()
    monkeypatch.setattr(watchdog, "RealClock", lambda: clock)
    monkeypatch.setattr(watchdog, "LOOK_S", 0.01)
    return clock


def watched(answer_s, late):
    """A watchdog; whom it breaks into is in the queue."""
    return Watchdog(answer_s, break_in=late.put, make_safe=lambda: None, tell=lambda line: None)


def test_a_call_may_take_twice_its_work_and_the_answer_time(clock):
    late = Queue()
    with watched(0.3, late) as dog:
        with dog.expect("a frame", 0.1):
            clock.nothing_late_after(0.49)
        assert late.empty()
        with pytest.raises(SafetyError, match=r"a frame has not returned for 0\.5\d* s"), dog.expect("a frame", 0.1):
            clock.late_after(0.51, late)
    assert late.empty()


def test_a_call_that_was_under_way_for_long_still_has_its_grace(clock):
    late = Queue()
    with watched(1000.0, late) as dog:
        with dog.expect("a frame"):
            clock.nothing_late_after(999.0)
            dog.hurry()
            clock.nothing_late_after(watchdog.GRACE_S - 0.1)
        assert late.empty()
        with pytest.raises(SafetyError), dog.expect("a frame"):
            clock.late_after(watchdog.GRACE_S + 0.1, late)


def test_an_instrument_that_waits_for_the_operator_does_not_hang(clock):
    asking = OperatorPrompt(lambda text: clock.nothing_late_after(1000.0) or "done")
    script, never = Script(VirtualClock()), threading.Event()
    script.on("load_cell.samples_since", lambda: asking("read the scale"), call=2)
    assert run(script=script, ask=asking)[0].end is EndReason.FINISHED

    def hang():
        clock.put_forward(1000.0)
        never.wait(30)

    script.on("load_cell.samples_since", hang, call=script.count("load_cell.samples_since") + 2)
    assert "rule 'no answer'" in run(script=script, ask=asking)[0].detail


def test_a_prompt_may_take_as_long_as_it_takes(clock):
    steps = (Prompt("turn it"), *CYCLE)
    assert run(steps, ask=lambda text: clock.nothing_late_after(1000.0))[0].end is EndReason.FINISHED


@pytest.mark.parametrize("who", ["journal", "listener"])
def test_a_journal_or_a_listener_that_hangs_keeps_no_head_down(who):
    """A terminal that was stopped by Ctrl-S, a disk that is away."""
    never = threading.Event()

    def hang(event):
        if isinstance(event, FramesTaken):
            never.wait(30)

    script, plan = Script(VirtualClock()), example_plan(CYCLE)
    plan = replace(plan, safety=replace(plan.safety, answer_s=0.3))
    bench = make_scripted_bench(script, plan.sensor_type)
    told = []
    subscribers = [hang, told.append] if who == "journal" else [told.append, hang]
    ended = execute(plan, example_identity(), bench, script.clock, subscribers, tell=lambda line: None)
    assert ended.end is EndReason.BROKEN
    assert "rule 'no answer': the journal or an event listener has not returned for" in ended.detail
    assert_made_safe(script)
    assert not bench.force_applicator.down


def test_a_wait_is_no_call_that_hangs():
    assert run((Hold(1.5, acquire=False),), script=Script(RealClock()), answer_s=0.3)[0].end is EndReason.FINISHED


def test_a_signal_ends_what_waits_for_the_operator_at_once():
    asking, never = OperatorPrompt(lambda text: never.wait(30) and "done"), threading.Event()
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
