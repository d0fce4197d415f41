"""Noise of the voltage readings."""

from typing import Final

import numpy as np

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream

#: What the materials' noise is stated at: the rig's script reads at 0.01 power line cycles. The paper prints none.
REFERENCE_NPLC: Final = 0.01


class MeasurementNoise:
    """Independent Gaussian noise on all readings, alike on each, less where a reading is averaged for longer.

    White noise averaged over a rectangular window of N power line cycles falls as √(1/N); what averaging does not
    take away adds to it in quadrature: rms² = floor² + (stated² − floor²) N₀/N. At N₀ it is the noise that
    was stated, floor and all.

    Departure from real converters: the floor is drawn afresh with every reading, so that means over frames beat it.

    Parameters
    ----------
    relative_noise : rms of one reading over the mean magnitude of the used readings of the unloaded sheet; by
        default the material's.
    nplc : N, power line cycles a reading is averaged over; the rig reads at 0.01.
    measured_at_nplc : N₀, at which ``relative_noise`` holds.
    relative_floor : what averaging does not take away, in the same unit; at most ``relative_noise``.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = ("voltmeter-input",)
    perturbs = "voltages"

    def __init__(
        self,
        setting: SceneSetting,
        *,
        relative_noise: float | None = None,
        nplc: float = REFERENCE_NPLC,
        measured_at_nplc: float = REFERENCE_NPLC,
        relative_floor: float = 0.0,
    ) -> None:
        stated = setting.material.relative_noise.value if relative_noise is None else relative_noise
        stated = number("relative_noise", stated, most=1e6)
        longer = number("nplc", nplc, above=True, most=25.0)
        longer /= number("measured_at_nplc", measured_at_nplc, above=True, most=25.0)
        floor = number("relative_floor", relative_floor)
        if floor > stated:
            raise ConfigError(
                f"relative_floor is {floor:g}, more than the noise it is part of",
                remedy=f"it is at most relative_noise, {stated:g}",
            )
        self._relative = float(np.sqrt(floor**2 + (stated - floor) * (stated + floor) / longer))
        self._stream = RandomStream(setting.seed, "measurement-noise")

    def apply(self, moment: Moment) -> None:
        """Add the frame's noise."""
        if moment.voltages is not None:
            rms_V = self._relative * moment.reading_scale_V
            moment.voltages = moment.voltages + rms_V * self._stream.normal(moment.index, moment.voltages.shape)
