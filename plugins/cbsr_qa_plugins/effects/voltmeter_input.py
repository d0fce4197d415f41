"""A voltmeter that is not ideal."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number

Array = NDArray[np.float64]


class VoltmeterInput:
    """The voltmeter loads what it measures: its input has a finite resistance, and a bias current flows out of it.

    U = (U₀ + i R) R_in/(R_in + R) of a pair that unloaded shows U₀ behind the resistance R (Thévenin): that between
    its electrodes, or with the driven pair held at the source's limit, R − R_md²/R_dd. Hardly seen on a sheet; a
    pair with an open lead, whose R is far beyond R_in, reads i R_in whatever is driven.

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
        self._driven = setting.sensor_type.pattern.drive_currents()
        self._measures = setting.sensor_type.pattern.measure_matrix()

    def apply(self, moment: Moment) -> None:
        """Load every pair."""
        if moment.voltages is None or moment.impedance_ohm is None:
            return
        ohm = self._behind(moment.impedance_ohm, moment)
        moment.voltages = (moment.voltages + self._bias_A * ohm) * (self._input_ohm / (self._input_ohm + ohm))

    def _behind(self, impedance_ohm: Array, moment: Moment) -> Array:
        """Resistance behind each reading while its pair is driven, (drives, measures)."""
        own = np.einsum("em,ef,fm->m", self._measures, impedance_ohm, self._measures)
        ohm = np.tile(own, (self._driven.shape[1], 1))
        if moment.current_A is not None and moment.drive_ohm is not None:
            limited = moment.current_A < moment.setting.current_A
            mutual = self._driven.T @ impedance_ohm @ self._measures
            ohm = ohm - np.where(limited, mutual**2 / moment.drive_ohm, 0.0)
        never_negative: Array = np.maximum(ohm, 0.0)
        return never_negative
