"""A voltmeter that is not ideal."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number

Array = NDArray[np.float64]


class VoltmeterInput:
    """The voltmeter loads what it measures: its input has a finite resistance, and a bias current flows out of it.

    U = (U₀ + i R) R_in/(R_in + R) of a pair that unloaded shows U₀ behind the resistance R (Thévenin): that between
    its electrodes as the reading is taken, or with the driven pair held at the source's limit, R − R_md²/R_dd. Hardly
    seen on a sheet; a pair with an open lead, whose R is far beyond R_in, reads i R_in whatever is driven.

    Parameters
    ----------
    input_ohm : R_in between the terminals; 10 GΩ is chosen by us.
    bias_A : i.
    """

    needs: tuple[str, ...] = ()
    perturbs = "voltages"

    def __init__(self, setting: SceneSetting, *, input_ohm: float = 1e10, bias_A: float = 0.0) -> None:
        self._input_ohm = number("input_ohm", input_ohm, above=True, most=1e15)
        self._bias_A = number("bias_A", bias_A, least=-1e-3, most=1e-3)

    def apply(self, moment: Moment) -> None:
        """Load every pair."""
        if moment.voltages is None or moment.measure_ohm is None:
            return
        ohm = _behind(moment, moment.voltages, moment.measure_ohm)
        moment.voltages = (moment.voltages + self._bias_A * ohm) * (self._input_ohm / (self._input_ohm + ohm))


def _behind(moment: Moment, voltages: Array, measure_ohm: Array) -> Array:
    """Resistance behind each reading while its pair is driven, (drives, measures)."""
    if moment.current_A is None or moment.drive_ohm is None:
        return measure_ohm
    limited = (moment.current_A < moment.setting.current_A) & (moment.drive_ohm > 0)
    mutual_ohm = voltages / moment.current_A  # nothing but the source has come before
    behind = measure_ohm - np.divide(mutual_ohm**2, moment.drive_ohm, out=np.zeros_like(voltages), where=limited)
    never_negative: Array = np.maximum(behind, 0.0)
    return never_negative
