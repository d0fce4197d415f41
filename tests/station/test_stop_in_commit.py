"""Two signals anywhere in the journal, also in the middle of a commit: the record stays whole, and says so."""

import os
import signal
import sys

import pytest
from stored_runs import CONFIGURATION, INDENTER, MATERIAL, SENSOR_TYPE, identity
from tiers import rest_but

from cbsr_qa.domain.plan.steps import Hold, Press, Release
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.events import FramesTaken, RunEnded
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.execution import execute
from cbsr_qa.store.opening import open_store
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, example_plan, make_scripted_bench

STEPS = (Press(Load("L0", 0.0, 0.0, 0.2, 0)), Hold(10, acquire=True), Release(), Hold(5, acquire=True))
#: Calls of Python functions after the frames are told: from the first to the last of a delivery.
CALLS = (1, 2, 5, 10, 20, 40, 60, 80, 120, 160, 200, 260, 300, 315, 330, 345, 360, 400)
#: From 311 to 347 a query's cursor is open, once statements are compiled.
KEPT = (1, 10, 60, 200, 315, 330, 345, 400)
SAFE = [f"{role}.safe_state" for role in ("force_applicator", "frame_source", "load_cell")]


@pytest.fixture(autouse=True)
def _as_at_a_terminal():
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGTERM, before)


class Torn:
    """A journal that gets two signals at the n-th call of a Python function within the delivery of one document."""

    def __init__(self, journal, kind, call):
        self.journal, self.kind, self.left, self.stored = journal, kind, call, []

    def __call__(self, event):
        if isinstance(event, self.kind) and self.left > 0:
            sys.setprofile(self._called)
        try:
            self.journal(event)
        finally:
            sys.setprofile(None)
        self.stored.append(event)

    def _called(self, frame, event, argument):
        if event == "call":
            self.left -= 1
            if self.left == 0:
                sys.setprofile(None)
                os.kill(os.getpid(), signal.SIGTERM)
                os.kill(os.getpid(), signal.SIGTERM)


def run_torn(path, kind, call):
    """Return how the run ended, what the journal stored, the run as the database gives it back, and the script."""
    script, plan = Script(VirtualClock()), example_plan(STEPS)
    bench = make_scripted_bench(script, plan.sensor_type)
    with open_store(f"sqlite:///{path}") as store:
        run = store.new_id()
        setting = {"sensor_type": SENSOR_TYPE, "material": MATERIAL, "indenter": INDENTER}
        torn = Torn(store.open_journal(configuration=CONFIGURATION, **setting), kind, call)
        ended = execute(plan, identity(run), bench, script.clock, [torn], tell=lambda line: None)
        return ended, torn, store.runs.load(run), script


@pytest.mark.parametrize("call", rest_but(KEPT, CALLS))
def test_frames_are_stored_whole_or_not_at_all(tmp_path, call):
    ended, torn, back, script = run_torn(tmp_path / "runs.db", FramesTaken, call)
    assert torn.left <= 0, "the delivery has not that many calls"
    assert ended.end is EndReason.ABORTED
    assert ended.detail.startswith("by signal SIGTERM and at once by a second signal, while")
    assert (back.end, back.end_detail) == (ended.end, ended.detail)
    kept = 0 if back.phases[0].frames is None else len(back.phases[0].frames)
    told = sum(isinstance(event, FramesTaken) for event in torn.stored)
    # What was told as stored is there; a frame whose commit was under way may be there as well, whole.
    assert kept in (told, told + 1)
    assert script.names()[-3:] == SAFE
    assert isinstance(torn.stored[-1], RunEnded)
