"""A scripted bench that is stopped, for tests of how."""

import os
import signal
import time
import weakref
from dataclasses import replace

from cbsr_qa.domain.plan.steps import Hold, Press, Release
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.station.execution import execute
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, example_identity, example_plan, make_scripted_bench

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


def send(number, times=1):
    def act():
        for _ in range(times):
            os.kill(os.getpid(), number)

    return act


class Handle:
    """Something whose end is noticed, as HDF5's handles are."""


def dropped(number, *, for_s=0.0):
    """Send a signal within a weak reference's callback, where what its handler raises is dropped."""
    handle = Handle()

    def gone(_):
        os.kill(os.getpid(), number)
        time.sleep(0)  # the handler runs here

    kept = weakref.ref(handle, gone)
    del handle
    assert kept() is None
    time.sleep(for_s)


def run(steps=CYCLE, *, script=None, listeners=(), answer_s=60.0, motion=None, frame_period_s=2.5, **options):
    """Execute steps; return how it ended, the documents, the script, the bench and what was said at once."""
    script = script or Script(VirtualClock())
    plan = example_plan(steps)
    plan = replace(plan, safety=replace(plan.safety, answer_s=answer_s), motion=motion or plan.motion)
    bench = make_scripted_bench(script, plan.sensor_type, frame_period_s=frame_period_s)
    told, said = [], []
    subscribers = [told.append, *listeners]
    ended = execute(plan, example_identity(), bench, script.clock, subscribers, tell=said.append, **options)
    return ended, told, script, bench, said


def after(script, name, call=1):
    """Names of the calls after the n-th of a name."""
    places = [number for number, one in enumerate(script.names()) if one == name]
    return script.names()[places[call - 1] + 1 :]


def assert_made_safe(script):
    """Everybody was told after the last other call; on a busy computer the run and the watchdog may both have."""
    last = max(number for number, name in enumerate(script.names()) if name not in SAFE)
    assert set(script.names()[last + 1 :]) == set(SAFE)
