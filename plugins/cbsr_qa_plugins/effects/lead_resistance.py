"""A lead or a contact in series with an electrode that went bad."""

import numpy as np

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import electrode, number


class LeadResistance:
    """A resistance between an electrode and the multiplexer, from a time on.

    A voltmeter draws no current: only the driven pairs of this electrode show it, as more resistance. An open
    electrode is a large one with ``source-compliance``: its drive pairs then carry next to nothing.

    Parameters
    ----------
    electrode : its number.
    resistance_ohm : in series.
    from_s, to_s : when, on the station's clock; by default always.
    """

    needs: tuple[str, ...] = ()
    perturbs = "impedance"

    def __init__(
        self,
        setting: SceneSetting,
        *,
        electrode: int,
        resistance_ohm: float,
        from_s: float = 0.0,
        to_s: float = 1e12,
    ) -> None:
        self._electrode = _electrode(electrode, setting)
        self._ohm = number("resistance_ohm", resistance_ohm, most=1e12)
        self._from_s, self._to_s = number("from_s", from_s), number("to_s", to_s)

    def apply(self, moment: Moment) -> None:
        """Add it to the electrode's own potential."""
        if moment.impedance_ohm is not None and self._from_s <= moment.time_s < self._to_s:
            own = np.zeros(len(moment.impedance_ohm))
            own[self._electrode] = self._ohm
            moment.impedance_ohm = moment.impedance_ohm + np.diag(own)


def _electrode(value: int, setting: SceneSetting) -> int:
    return electrode("electrode", value, setting.sensor_type.electrodes.count)
