"""Thermal noise of the sheet itself."""

import numpy as np
from scipy.constants import Boltzmann, zero_Celsius

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream


class JohnsonNoise:
    """Thermal noise of the resistance that each measured pair sees as it is read, independent between readings.

    √(4 k T R Δf) (Nyquist 1928). Readings average over N power line cycles, Δf = 1/(2 T_int) of a rectangular window.

    Parameters
    ----------
    nplc : N; the rig reads at 0.01.
    mains_Hz : of the mains.
    temperature_C : of the sheet.
    """

    needs: tuple[str, ...] = ()
    perturbs = "voltages"

    def __init__(
        self, setting: SceneSetting, *, nplc: float = 0.01, mains_Hz: float = 50.0, temperature_C: float = 23.0
    ) -> None:
        integration_s = number("nplc", nplc, above=True, most=25.0) / number("mains_Hz", mains_Hz, above=True)
        kelvin = zero_Celsius + number("temperature_C", temperature_C, least=-zero_Celsius, most=300.0)
        self._per_ohm = 4 * Boltzmann * kelvin / (2 * integration_s)
        self._stream = RandomStream(setting.seed, "johnson-noise")

    def apply(self, moment: Moment) -> None:
        """Add the frame's noise."""
        if moment.voltages is not None and moment.measure_ohm is not None:
            drawn = self._stream.normal(moment.index, moment.voltages.shape)
            moment.voltages = moment.voltages + np.sqrt(self._per_ohm * moment.measure_ohm) * drawn
