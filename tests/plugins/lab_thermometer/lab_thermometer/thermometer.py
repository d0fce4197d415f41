"""A thermometer that reads a slow, known drift once a second."""

import numpy as np

from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.plugin.options import PluginOptions, driver


class Thermometer:
    """Room temperature rising steadily: what the test can compute by hand."""

    channel = "temperature"
    unit = "°C"

    def __init__(self, context, start_C, rise_C_per_h):
        self._context = context
        self._start_C = start_C
        self._rise_C_per_h = rise_C_per_h

    def identity(self):
        """Say who this is."""
        return InstrumentIdentity(
            role=self._context.role,
            driver="lab-thermometer",
            model="Lab thermometer T-1",
            serial="T1-0042",
            firmware="1.0",
            simulated=True,
        )

    def samples_since(self, time_s):
        """One sample at every full second."""
        times = np.arange(np.floor(time_s) + 1, np.floor(self._context.clock.now()) + 1)
        return SampleBlock(self.channel, self.unit, times, self._start_C + self._rise_C_per_h * times / 3600)

    def safe_state(self):
        """Nothing to stop."""

    def close(self):
        """Nothing to close."""


class ThermometerOptions(PluginOptions):
    """Options of its table in the station file."""

    start_C: float
    rise_C_per_h: float


@driver("lab-thermometer", ThermometerOptions)
def open_thermometer(context, options):
    """Make one from its table in the station file."""
    return Thermometer(context, options.start_C, options.rise_C_per_h)
