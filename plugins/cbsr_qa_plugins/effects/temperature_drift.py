"""The room warms and cools."""

import math

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number


class TemperatureDrift:
    """The room warms steadily and swings, and sheet and contacts conduct better or worse with it.

    By 1 + c ΔT, ΔT(t) = rate t + swing sin(2π t/period).

    Parameters
    ----------
    coefficient_per_K : c.
    rate_K_per_h : of the warming.
    swing_K, period_s : of what comes and goes, such as air conditioning.
    """

    needs: tuple[str, ...] = ()
    perturbs = "impedance"

    def __init__(
        self,
        setting: SceneSetting,
        *,
        coefficient_per_K: float,
        rate_K_per_h: float = 0.0,
        swing_K: float = 0.0,
        period_s: float = 1200.0,
    ) -> None:
        self._coefficient = number("coefficient_per_K", coefficient_per_K, least=-0.05, most=0.05)
        self._rate_K_per_s = number("rate_K_per_h", rate_K_per_h, least=-20.0, most=20.0) / 3600
        self._swing_K = number("swing_K", swing_K, most=10.0)
        self._period_s = number("period_s", period_s, above=True)

    def apply(self, moment: Moment) -> None:
        """Scale what the electrodes see."""
        if moment.impedance_ohm is not None:
            warmer_K = self._rate_K_per_s * moment.run_s
            warmer_K += self._swing_K * math.sin(2 * math.pi * moment.run_s / self._period_s)
            factor = 1 + self._coefficient * warmer_K
            if factor <= 0:
                raise RefusedError(
                    f"temperature-drift leaves no conductance at {moment.run_s:g} s, {warmer_K:g} K from the start",
                    remedy="take a smaller coefficient_per_K, rate_K_per_h or swing_K",
                )
            moment.impedance_ohm = moment.impedance_ohm / factor
