"""How much the temperature changed over a run."""

import numpy as np

from cbsr_qa.domain.results.measurement import Measurement


class TemperatureSpan:
    """Highest minus lowest temperature."""

    measures = {"temperature_span": "°C"}  # noqa: RUF012

    def measure_run(self, run):
        """Measure it, or say that nobody recorded a temperature."""
        blocks = [b for p in run.record.phases for b in p.samples if b.channel == "temperature"]
        if not blocks:
            return (Measurement("temperature_span", None, "°C", how="no thermometer on this station"),)
        values = np.concatenate([b.values for b in blocks])
        return (Measurement("temperature_span", float(np.ptp(values)), "°C", how="lab thermometer"),)
