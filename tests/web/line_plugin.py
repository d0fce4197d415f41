"""A sequence that asks the operator, and a bench that stops answering in the middle of a run."""

from cbsr_qa.domain import InstrumentError
from cbsr_qa.domain.plan import Prompt
from cbsr_qa.plugin import Kind, hookimpl
from cbsr_qa_plugins.hardware.simulated_bench import BenchOptions, SimulatedBench, driver

_FRAMES_BEFORE_DEATH = 20


class Asks:
    """Two questions."""

    def steps(self, context):
        yield Prompt("Wipe the sheet <b>dry</b>. Is there dust on it?")
        yield Prompt("Close the cover.")


class DyingBench(SimulatedBench):
    """A bench that takes some frames, and then none."""

    _taken = 0

    def acquire(self, count):
        self._taken += count
        if self._taken > _FRAMES_BEFORE_DEATH:
            raise InstrumentError("bench", "nowhere", "does not answer: its cable was pulled out")
        return super().acquire(count)


@driver("dying-bench", BenchOptions)
def open_dying(context, options):
    """Open it."""
    return DyingBench(context, options)


@hookimpl
def cbsr_register(register):
    """Register both."""
    register(Kind.SEQUENCE, "asks", "line_plugin:Asks")
    register(Kind.INSTRUMENT, "dying-bench", "line_plugin:open_dying")
