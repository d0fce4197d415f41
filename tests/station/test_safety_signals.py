"""Safety: signals end a run as its operator does, and none keeps the head down or tears the journal."""

import os
import signal

import pytest
from safety_runs import SHORT, assert_safe, run

from cbsr_qa.domain.errors import AbortedError
from cbsr_qa.domain.run.events import FramesTaken
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.execution import execute
from cbsr_qa.station.interrupts import Interrupts, Stopped
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, example_identity, example_plan, make_scripted_bench


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
def test_a_signal_waits_until_the_journal_has_stored():
    stored = []

    def journal(event):
        if isinstance(event, FramesTaken) and not any(isinstance(e, FramesTaken) for e in stored):
            os.kill(os.getpid(), signal.SIGINT)
        stored.append(event)  # reached: the signal did not tear this apart

    script = Script(VirtualClock())
    plan = example_plan(SHORT)
    bench = make_scripted_bench(script, plan.sensor_type)
    ended = execute(plan, example_identity(), bench, script.clock, [journal])
    assert ended.end is EndReason.ABORTED
    assert sum(isinstance(e, FramesTaken) for e in stored) == 1
    assert_safe(script, bench)


@pytest.mark.usefixtures("as_at_a_terminal")
def test_a_second_signal_breaks_through_a_delivery_that_hangs():
    reached = []

    def hang(interrupts):
        with interrupts.listen(), interrupts.defer():
            os.kill(os.getpid(), signal.SIGTERM)
            reached.append("after the first signal")
            os.kill(os.getpid(), signal.SIGTERM)
            reached.append("after the second signal")

    with Interrupts() as interrupts, pytest.raises(Stopped, match="SIGTERM"):
        hang(interrupts)
    assert reached == ["after the first signal"]
