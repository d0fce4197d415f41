"""Runs of a short plan over a scripted bench, for the tests of safety."""

from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, MarkUnloaded, Press, Release, StrainStep
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.station.execution import execute
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, example_identity, example_plan, make_scripted_bench

LOAD = Load("L0", 0.0, 0.0, 0.2, 0)
SHORT = (
    FindSurface(0, 0),
    Hold(6, acquire=False),
    MarkUnloaded(),
    AcquireFrames(2),
    Press(LOAD),
    Hold(5, acquire=True),
    Hold(2, acquire=False),
    StrainStep(0.3),
    Hold(5, acquire=True),
    StrainStep(0.1),
    Hold(2, acquire=False),
    Release(),
    Hold(5, acquire=True),
)
ROLES = ("force_applicator", "frame_source", "load_cell")


def run(steps=SHORT, *, script=None, listeners=()):
    script = script or Script(VirtualClock())
    plan = example_plan(steps)
    bench = make_scripted_bench(script, plan.sensor_type)
    documents = []
    ended = execute(plan, example_identity(), bench, script.clock, [documents.append, *listeners])
    return ended, documents, script, bench


SAFE = [f"{role}.safe_state" for role in ROLES]


def assert_safe(script, bench):
    """Every instrument was told to reach its safe state, after everything else, and the head is up."""
    assert script.names()[-len(SAFE) :] == SAFE
    assert not bench.force_applicator.down
