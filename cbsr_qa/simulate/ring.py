"""A ring of resistors where the simulated sheet would be: what a station check measures."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.scene import SheetDesign
from cbsr_qa.forward.resistor_ring import ring_impedance
from cbsr_qa.simulate.sheet import Place

Array = NDArray[np.float64]


class SimulatedRing:
    """Resistors between neighbouring electrodes, in place of a sheet.

    It is plugged in where the sensor is, so that what leads, source, meter and converter do to a reading they do here
    too. Effects on the sheet and its contacts do nothing: the resistors are soldered, and there is nothing to press.

    Parameters
    ----------
    design : of the sheet that is not there; its electrodes are the ring's terminals.
    resistances_ohm : the first between electrodes 0 and 1, the last between the last one and 0.

    Raises
    ------
    ConfigError
        If there are not as many as electrodes.
    NumericsError
        If one is not above zero.
    """

    def __init__(self, design: SheetDesign, resistances_ohm: Sequence[float]) -> None:
        self.design = design
        self.sensor_type = design.sensor_type
        electrodes = self.sensor_type.electrodes.count
        if len(resistances_ohm) != electrodes:
            raise ConfigError(
                f"reference_ring_ohm has {len(resistances_ohm)} resistors; the sensor type has {electrodes}"
                " electrodes",
                remedy="give one for each pair of neighbouring electrodes",
            )
        self._impedance = ring_impedance(resistances_ohm)
        #: readings, (drives, measures) [V/A]
        self.unloaded: Array = self.readings(self._impedance)

    def impedances(self, changes: Sequence[Mapping[Place, float]], contact_mm: Array | None = None) -> Array:
        """The ring's own at every moment, (moments, electrodes, electrodes) [V/A], whatever is pressed."""
        return np.repeat(self._impedance[None], len(changes), axis=0)

    def readings(self, impedance_ohm: Array) -> Array:
        """Readings per ampere of a transfer impedance: (drives, measures) [V/A]."""
        pattern = self.sensor_type.pattern
        readings: Array = pattern.drive_currents().T @ impedance_ohm @ pattern.measure_matrix()
        return readings

    def pressed_mm2(self, place: Place) -> float:
        """Nothing lies under a head."""
        return 0.0
