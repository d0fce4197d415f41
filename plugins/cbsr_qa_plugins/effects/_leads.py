"""What lies outside the sheet: in series with an electrode, or between two."""

from typing import Final

from cbsr_qa.domain.scene import Moment

#: Effects on sheet and contacts, which leave what is outside as it is.
BESIDE_THE_SHEET: Final = ("temperature-drift",)


def in_series(moment: Moment, electrode: int, resistance_ohm: float) -> None:
    """Add a resistance to an electrode's own potential.

    A voltmeter draws no current through it: only the driven pairs of this electrode show it.
    """
    if moment.impedance_ohm is not None:
        impedance = moment.impedance_ohm.copy()
        impedance[electrode, electrode] += resistance_ohm
        moment.impedance_ohm = impedance
