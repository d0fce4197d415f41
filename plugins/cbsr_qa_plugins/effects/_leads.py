"""What is in series with an electrode."""

from cbsr_qa.domain.scene import Moment


def in_series(moment: Moment, electrode: int, resistance_ohm: float) -> None:
    """Add a resistance to an electrode's own potential.

    A voltmeter draws no current through it: only the driven pairs of this electrode show it.
    """
    if moment.impedance_ohm is not None:
        impedance = moment.impedance_ohm.copy()
        impedance[electrode, electrode] += resistance_ohm
        moment.impedance_ohm = impedance
