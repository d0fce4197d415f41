"""Signals, through the drivers of a real bench: whatever they are in the middle of, head up and source off."""

import os
import signal
from dataclasses import replace

import pytest

from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, Home, Press, Release
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.events import StepStarted
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.station.execution import execute
from cbsr_qa.station.plan import PlannedPhase
from cbsr_qa.station.setup import configure, open_station, plan_of, station_clock
from cbsr_qa.testing.bench import FixedSequence, example_identity

STEPS = (
    Home(),
    FindSurface(0.0, 0.0),
    AcquireFrames(1),
    Press(Load("L0", 0.0, 0.0, 0.2, 0)),
    Hold(5.0, acquire=True),
    Release(),
)


@pytest.fixture(autouse=True)
def _as_at_a_terminal():
    before = {number: signal.signal(number, signal.SIG_DFL) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


class Stopped:
    """A run over the emulated bench that gets signals when a step begins, or while the head is on its way in it."""

    def __init__(self, step, *signals, moving=False):
        self.step, self.signals, self.first, self.moving = step, signals, signals[0], moving
        self.reached, self.heard = False, []
        here, plugins = (
            configure("bench-emulated", "nine-locations", sensor_type=None, material=None, seed=5),
            discover(),
        )
        self.clock = station_clock(here)
        bench = open_station(here, plugins, self.clock, emulated=self._take)
        self.clock.watch(lambda now_s: self._sends(self.rig.head.moving))
        plan = replace(plan_of(here, plugins), phases=(PlannedPhase("short", "fixed", FixedSequence(STEPS)),))
        try:
            self.ended = execute(plan, example_identity(), bench, self.clock, [self._journal], tell=self.heard.append)
            self.clock.sleep(10.0)  # the head is on its way up
            head, wiring = self.rig.head, self.rig.wiring
            self.head_up, self.dragged, self.current_A = head.up, head.dragged, wiring.current_A
        finally:
            bench.close()

    def _take(self, emulation):
        self.rig = emulation.rig

    def _journal(self, event):
        self.reached = self.reached or (isinstance(event, StepStarted) and isinstance(event.step, self.step))
        self._sends(not self.moving)

    def _sends(self, now):
        """Send what is left to be sent, once the step is reached; the emulated head moves in a thread of its own."""
        if self.reached and now:
            signals, self.signals = self.signals, ()
            for number in signals:
                os.kill(os.getpid(), number)


def assert_at_rest(stopped):
    assert stopped.ended.end is EndReason.ABORTED
    assert stopped.ended.detail.startswith(f"by signal {stopped.first.name}")
    assert "NOT SAFE" not in stopped.ended.detail
    assert stopped.head_up
    assert not stopped.dragged
    assert stopped.current_A is None


def test_the_head_is_lifted_in_order():
    stopped = Stopped(Hold, signal.SIGTERM)
    assert_at_rest(stopped)
    assert "holding still for 5 s" in stopped.ended.detail
    assert dict(stopped.ended.spent)["release"] > 1.0  # at its press speed out of the sheet
    assert len(stopped.heard) == 1


def test_a_press_under_way_is_finished_and_taken_back():
    stopped = Stopped(Press, signal.SIGTERM, moving=True)
    assert_at_rest(stopped)
    assert "pressing L0" in stopped.ended.detail
    assert len(stopped.heard) == 1


@pytest.mark.parametrize("step", [Home, FindSurface, Press, pytest.param(Release, marks=pytest.mark.rest)])
def test_two_signals_while_the_driver_waits_for_the_head_leave_the_bench_safe(step):
    stopped = Stopped(step, signal.SIGHUP, signal.SIGTERM, moving=True)
    assert_at_rest(stopped)
    assert "and at once by a second signal" in stopped.ended.detail
    assert len(stopped.heard) == 2
