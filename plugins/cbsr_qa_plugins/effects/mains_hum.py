"""The mains, as far as the integration time lets it through."""

import numpy as np

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream


class MainsHum:
    """A sine of the mains' frequency on all readings, averaged over each reading's integration.

    A sinc(N) sin(2π f t + φ) for N power line cycles: nothing is left at whole cycles, nearly all at 0.01. The phase
    is drawn once per seed.

    Parameters
    ----------
    amplitude_V : A.
    nplc : N, integration time in cycles of the mains; the rig reads at 0.01.
    mains_Hz : f.
    """

    needs: tuple[str, ...] = ("time-skew",)
    perturbs = "voltages"

    def __init__(
        self, setting: SceneSetting, *, amplitude_V: float, nplc: float = 0.01, mains_Hz: float = 50.0
    ) -> None:
        cycles = number("nplc", nplc, above=True, most=25.0)
        self._amplitude_V = number("amplitude_V", amplitude_V) * float(np.sinc(cycles))
        self._rate_rad_s = 2 * np.pi * number("mains_Hz", mains_Hz, above=True, most=1e3)
        self._phase = float(RandomStream(setting.seed, "mains-hum").generator(0).uniform(0, 2 * np.pi))

    def apply(self, moment: Moment) -> None:
        """Add the hum of each reading's own time."""
        if moment.voltages is not None and moment.reading_offsets_s is not None:
            turned = self._rate_rad_s * (moment.run_s + moment.reading_offsets_s) + self._phase
            moment.voltages = moment.voltages + self._amplitude_V * np.sin(turned)
