"""Two electrodes that touch."""

import numpy as np

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import electrode, number, shown
from cbsr_qa_plugins.effects._leads import BESIDE_THE_SHEET


class ElectrodeShort:
    """Two electrodes touch: there is a resistance between them, beside the sheet.

    Exact: with Z the sheet's transfer impedance and a = e_i − e_j, the short takes Z a aᵀ Z/(r + aᵀ Z a) from it.

    Parameters
    ----------
    electrodes : the two.
    resistance_ohm : between them; 0 is a dead short.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = BESIDE_THE_SHEET
    perturbs = "impedance"

    def __init__(self, setting: SceneSetting, *, electrodes: list[int], resistance_ohm: float = 0.0) -> None:
        count = setting.sensor_type.electrodes.count
        if not isinstance(electrodes, list | tuple) or len(electrodes) != 2 or electrodes[0] == electrodes[1]:
            raise ConfigError(f"electrodes is {shown(electrodes)}", remedy="it is a list of two different electrodes")
        self._between = np.zeros(count)
        for number_, sign in zip(electrodes, (1.0, -1.0), strict=True):
            self._between[electrode("electrodes", number_, count)] = sign
        self._ohm = number("resistance_ohm", resistance_ohm)

    def apply(self, moment: Moment) -> None:
        """Put the resistance beside the sheet."""
        if moment.impedance_ohm is not None:
            seen = moment.impedance_ohm @ self._between
            moment.impedance_ohm = moment.impedance_ohm - np.outer(seen, seen) / (self._ohm + self._between @ seen)
