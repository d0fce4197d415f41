"""A sequence that asks the operator, a bench that stops answering in the middle of a run, and an impatient page."""

import sys
import time

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.plan.steps import Prompt
from cbsr_qa.plugin.hooks import Kind, hookimpl
from cbsr_qa_plugins.hardware.simulated_bench import BenchOptions, SimulatedBench, driver

_FRAMES_BEFORE_DEATH = 20
#: How long it hangs before it is found dead, and after what time without frames the page says so [s].
_HANGS_S = 4.0
_SILENT_S = 1.5

if "cbsr_qa.web.watching" in sys.modules:  # a minute in earnest
    sys.modules["cbsr_qa.web.watching"].SILENT_S = _SILENT_S


class Asks:
    """A question."""

    def steps(self, context):
        yield Prompt("Wipe the sheet <b>dry</b>. Is there dust on it?")


class DyingBench(SimulatedBench):
    """A bench that takes some frames, and then none."""

    _taken = 0

    def acquire(self, count):
        self._taken += count
        if self._taken > _FRAMES_BEFORE_DEATH:
            time.sleep(_HANGS_S)
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
