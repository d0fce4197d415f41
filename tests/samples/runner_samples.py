"""Phases on a scripted bench, for tests of the runner."""

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, MarkUnloaded, Press, Release
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.station.execution import execute
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, example_identity, example_plan, make_scripted_bench

TOOK_S = {
    "force_applicator.home": 6.0,
    "force_applicator.find_surface": 9.0,
    "force_applicator.move_to": 3.0,
    "force_applicator.press": 3.5,
    "force_applicator.release": 3.25,
}
SET_UP = (FindSurface(0, 0), Hold(240, acquire=False), MarkUnloaded(), AcquireFrames(16))


def load(number=0, strain=0.2, x_mm=0.0):
    return Load(f"L{number}", x_mm, 0.0, strain, 0)


def cycle(number=0, **options):
    return (Press(load(number, **options)), Hold(60, acquire=True), Release(), Hold(60, acquire=True))


def run(*phases, script=None, done=frozenset(), listeners=(), journal=None, **options):
    """Execute phases on a scripted bench; return how it ended, the documents, the script."""
    script = script or Script(VirtualClock(), TOOK_S)
    plan = example_plan(*phases)
    documents = []
    bench = make_scripted_bench(script, plan.sensor_type)
    subscribers = [journal or documents.append, *listeners]
    ended = execute(plan, example_identity(), bench, script.clock, subscribers, done=done, **options)
    return ended, documents, script


def kinds(documents, *which):
    return [document for document in documents if isinstance(document, which)]


def lost(role="frame_source"):
    return InstrumentError(role, "COM3", "no reply", retryable=True)
