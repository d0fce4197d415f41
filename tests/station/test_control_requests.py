"""A run on a scripted bench that is paused, continued and stopped by others, and what it asks them."""

import threading
import time
from contextlib import suppress
from dataclasses import astuple

import pytest
from stopping import CYCLE, assert_made_safe, run

from cbsr_qa.domain.errors import AbortedError, InstrumentError, RefusedError
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, MarkUnloaded, Press, Prompt, Release
from cbsr_qa.domain.run.attendance import PromptAnswered, PromptShown, RunContinued, RunPaused
from cbsr_qa.domain.run.events import FramesTaken, LoadFinished, StepStarted
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.control.desk import ControlDesk, Question
from cbsr_qa.station.prompts import OperatorPrompt
from cbsr_qa.system.clock import VirtualClock, passing
from cbsr_qa.testing.bench import Script, ScriptedApplicator

#: Two presses after unloaded frames.
STEPS = (FindSurface(0, 0), Hold(30, acquire=False), MarkUnloaded(), AcquireFrames(2), *CYCLE, *CYCLE)


class Beside(threading.Thread):
    """Somebody who watches a desk and acts when it shows something."""

    def __init__(self, desk, when, act):
        super().__init__(daemon=True)
        self._desk, self._when, self._act = desk, when, act
        self._changed, self.said = threading.Event(), []
        desk.changed = self._changed.set
        self.start()

    def run(self):
        while not self._when(self._desk.state()):
            assert self._changed.wait(20), "nothing has changed"
            self._changed.clear()
        try:
            self._act()
        except RefusedError as error:
            self.said.append(error.reason)


def at(kind, act, count=1):
    """A listener that acts at the n-th step of a kind."""
    seen = []

    def listener(event):
        if isinstance(event, StepStarted) and isinstance(event.step, kind):
            seen.append(event)
            if len(seen) == count:
                act()

    return listener


def fast():
    """A clock on which a pause of milliseconds takes seconds of the station."""
    return Script(VirtualClock(speed=2000.0))


def words(documents):
    """Steps, ends of loads, pauses: what happened in which order."""
    kinds = (StepStarted, LoadFinished, RunPaused, RunContinued)
    return [type(getattr(each, "step", each)).__name__ for each in documents if isinstance(each, kinds)]


def test_a_pause_asked_for_in_a_press_comes_after_its_rest_and_frames_are_taken_again_before_the_next():
    desk = ControlDesk()
    beside = Beside(desk, lambda state: state.paused, lambda: desk.resume("Grace"))
    ended, documents, script, bench, _ = run(STEPS, listeners=[at(Press, lambda: desk.pause("Ada"))], desk=desk)
    beside.join(20)
    assert ended.end is EndReason.FINISHED
    told = words(documents)
    first = told.index("RunPaused")
    assert told[first - 5 :] == [
        "Press", "Hold", "Release", "Hold", "LoadFinished",
        "RunPaused", "RunContinued", "Hold",
        "Press", "Hold", "Release", "Hold", "LoadFinished",
    ]  # fmt: skip
    (paused,), (continued,) = (
        [one for one in documents if isinstance(one, kind)] for kind in (RunPaused, RunContinued)
    )
    record, later = [one.record for one in documents if isinstance(one, LoadFinished)]
    assert (paused.by, continued.by) == ("Ada", "Grace")
    assert record.rest_end_s == paused.time_s <= continued.time_s
    frames_s = [one.frames.time_s[-1] for one in documents if isinstance(one, FramesTaken)]
    assert sum(continued.time_s < time_s < later.press_start_s for time_s in frames_s) == 4
    assert dict(ended.spent)["pause"] == continued.time_s - paused.time_s
    left_s = [
        [one.remaining_s for one in told if isinstance(one, StepStarted)] for told in (documents, run(STEPS)[1])
    ]
    assert left_s[0][-1] == pytest.approx(left_s[1][-1])  # the frames that were taken again were expected
    assert not bench.force_applicator.down
    assert script.count("force_applicator.press") == 2


def test_a_pause_before_the_first_press_takes_the_unloaded_frames_again_after_a_new_mark_without_another_rest():
    desk = ControlDesk()
    beside = Beside(desk, lambda state: state.paused, lambda: desk.resume("Ada"))
    _, documents, *_ = run(STEPS, listeners=[at(AcquireFrames, lambda: desk.pause("Ada"))], desk=desk)
    beside.join(20)
    told = words(documents)
    first = told.index("RunPaused")
    assert told[first : first + 5] == ["RunPaused", "RunContinued", "MarkUnloaded", "AcquireFrames", "Press"]


def test_a_request_that_is_withdrawn_before_the_press_pauses_nothing():
    desk = ControlDesk()
    listeners = [at(Press, lambda: desk.pause("Ada")), at(Release, lambda: desk.resume("Ada"))]
    ended, documents, *_ = run(STEPS, listeners=listeners, desk=desk)
    assert ended.end is EndReason.FINISHED
    assert "RunPaused" not in words(documents)


@pytest.mark.parametrize("what", ["force", "heartbeat"])
def test_limits_and_heartbeat_are_watched_in_a_pause(monkeypatch, what):
    desk, script = ControlDesk(), fast()

    def answering(self):
        if desk.state().paused:
            raise InstrumentError("force_applicator", "COM3", "no reply")

    if what == "force":
        script.force_N = lambda now_s, down: 1e4 if desk.state().paused else 0.0
    else:
        monkeypatch.setattr(ScriptedApplicator, "alive", answering, raising=False)
    ended, documents, *_ = run(STEPS, script=script, listeners=[at(Press, lambda: desk.pause("Ada"))], desk=desk)
    assert ended.end is EndReason.BROKEN
    assert ended.detail.startswith(f"rule '{what}'")
    assert "RunContinued" not in words(documents)
    assert_made_safe(script)


@pytest.mark.parametrize(
    ("stop", "said"), [("stop", "by Ada (remote)"), ("emergency", "by an emergency stop by Ada (remote)")]
)
def test_a_pause_is_stopped_at_once(stop, said):
    desk = ControlDesk()
    beside = Beside(desk, lambda state: state.paused, lambda: getattr(desk, stop)("Ada"))
    ended, _, script, *_ = run(STEPS, listeners=[at(Press, lambda: desk.pause("Ada"))], desk=desk)
    beside.join(20)
    assert ended.end is EndReason.ABORTED
    assert ended.detail.startswith(f"{said}, while ")
    assert script.count("force_applicator.press") == 1
    assert_made_safe(script)


def test_a_stop_in_a_press_lifts_the_head_in_order_and_names_who_asked():
    desk = ControlDesk()
    listeners = [at(Hold, lambda: desk.stop("Ada"), count=2)]
    ended, _, script, bench, said = run(STEPS, listeners=listeners, desk=desk)
    assert ended.end is EndReason.ABORTED
    assert ended.detail.startswith("by Ada (remote), while holding still for 10 s")
    assert script.count("force_applicator.release") == 1
    assert not bench.force_applicator.down
    assert "Ada" in said[0]
    with pytest.raises(RefusedError, match="does not move now"):
        desk.pause("Ada")


def test_an_emergency_stop_makes_the_bench_safe_while_a_driver_hangs_and_swallows_everything():
    desk, script, safe = ControlDesk(), fast(), threading.Event()

    def hang():
        threading.Thread(target=desk.emergency, args=("Ada",), daemon=True).start()
        until_s = time.monotonic() + 20
        while not safe.is_set() and time.monotonic() < until_s:
            with suppress(BaseException):  # a driver may
                safe.wait(20)

    script.on("frame_source.acquire", hang, call=4)
    script.on("load_cell.safe_state", safe.set, call=2)  # the first is before the run
    ended, *_ = run(STEPS, script=script, desk=desk)
    assert safe.is_set()
    assert ended.end is EndReason.ABORTED
    assert "an emergency stop by Ada" in ended.detail


def test_a_prompt_takes_one_answer_and_is_stored_with_its_answer():
    desk, told = ControlDesk(answers=True), []

    def answers():
        open_one = desk.state().prompt
        told.append(open_one)
        for by, text in (("Ada", "done"), ("Grace", "no")):
            desk.answer(open_one.prompt, text, by)

    beside = Beside(desk, lambda state: state.prompt, answers)
    asking = OperatorPrompt(None, desk, first=3)
    steps = (Prompt("Turn the sheet", "/somewhere/sheet.png"), *CYCLE)
    ended, documents, *_ = run(steps, ask=asking, desk=desk)
    beside.join(20)
    assert ended.end is EndReason.FINISHED
    assert [astuple(one) for one in told] == [(3, "Turn the sheet", "/somewhere/sheet.png", True)]
    assert beside.said == ["prompt 3 has been answered by Ada"]
    shown, answered = [one for one in documents if isinstance(one, PromptShown | PromptAnswered)]
    assert (shown.prompt, shown.text, shown.picture) == (3, "Turn the sheet", "sheet.png")
    assert (answered.prompt, answered.answer, answered.by) == (3, "done", "Ada")
    assert desk.state().prompt is None


def test_a_prompt_in_a_terminal_is_shown_to_others_who_cannot_answer_it():
    desk = ControlDesk()
    shown = []

    def terminal(text):
        shown.append(desk.state().prompt.here)
        with pytest.raises(RefusedError, match="answer there"):
            desk.answer(0, "yes", "Grace")
        return "yes"

    ended, documents, *_ = run(
        (Prompt("Ready?"), *CYCLE), ask=OperatorPrompt(terminal, desk, operator="Ada"), desk=desk
    )
    assert (ended.end, shown) == (EndReason.FINISHED, [False])
    assert [one.by for one in documents if isinstance(one, PromptAnswered)] == ["Ada"]


def test_a_stop_ends_a_prompt_also_while_the_bench_is_opened():
    desk = ControlDesk(answers=True)
    beside = Beside(desk, lambda state: state.prompt, lambda: desk.stop("Ada"))
    with pytest.raises(AbortedError, match="Ada"):
        OperatorPrompt(None, desk)("Put 100 g on the load cell")
    beside.join(20)
    beside = Beside(desk := ControlDesk(answers=True), lambda state: state.prompt, lambda: desk.stop("Ada"))
    ended, *_ = run((Prompt("Ready?"), *CYCLE), ask=OperatorPrompt(None, desk), desk=desk)
    assert (ended.end, ended.detail[:15]) == (EndReason.ABORTED, "by Ada (remote)")


def test_nothing_that_is_done_differs_on_a_paced_clock():
    plain, paced = (run(STEPS, script=Script(VirtualClock(speed=speed))) for speed in (None, 5000.0))
    assert [repr(one) for one in plain[1]] == [repr(one) for one in paced[1]]
    assert plain[2].calls == paced[2].calls


def test_a_paced_clock_waits_and_time_passes_on_it_while_somebody_is_waited_for():
    clock, before_s = VirtualClock(speed=1000.0), time.monotonic()
    clock.sleep(100.0)
    assert time.monotonic() - before_s >= 0.1
    assert clock.now() == 100.0
    passing(clock, time.sleep, 50.0)
    assert clock.now() >= 150.0


def test_what_cannot_be_done_is_refused_with_the_reason():
    desk = ControlDesk()
    for ask, said in (
        (desk.resume, "not paused"),
        (desk.pause, "does not move"),
        (desk.stop, "nothing to stop"),
        (desk.emergency, "nothing to stop"),
    ):
        with pytest.raises(RefusedError, match=said):
            ask("Ada")
    assert desk.state().stopping is None
    with pytest.raises(RefusedError, match="prompt 0 is not open"):
        desk.answer(0, "yes", "Ada")


def test_a_stop_asked_for_while_the_bench_is_opened_stops_the_run_even_if_an_answer_came_before():
    desk = ControlDesk(answers=True)
    desk.show(Question(0, "Is the ring connected?"))
    desk.answer(0, "yes", "Ada")
    desk.stop("Grace")
    desk.show(None)
    ended, documents, *_ = run(STEPS, desk=desk)
    assert ended.end is EndReason.ABORTED
    assert "by Grace" in ended.detail
    assert "Press" not in words(documents)
