"""A ring of resistors between neighbouring electrodes: what a station should read of it, in closed form."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.patterns import DrivePattern

Array = NDArray[np.float64]

#: Fewer resistors are no ring.
FEWEST_RESISTORS = 3


def ring_impedance(resistances_ohm: Sequence[float] | Array) -> Array:
    """Transfer impedance of a ring of resistors, for currents that sum to zero and differences of potentials.

    Between electrodes i and j lie two arcs in parallel, of s and S − s ohms where S is the whole ring: their
    resistance is r = s (S − s) / S, for equal resistors R k (n − k) / n at distance k (Klein and Randić, Resistance
    distance, J. Math. Chem. 12 (1993) 81–95). A current from a to b makes between c and d the voltage
    (r_bc + r_ad − r_ac − r_bd) / 2 per ampere, so that −r / 2 is a transfer impedance.

    Parameters
    ----------
    resistances_ohm : (n,) the first between electrodes 0 and 1, the last between the last one and 0.

    Returns
    -------
    (n, n) float64 [V/A], symmetric.

    Raises
    ------
    NumericsError
        If there are fewer than three resistors, or one is not above zero and finite.
    """
    ohm = np.asarray(resistances_ohm, dtype=np.float64)
    if ohm.ndim != 1 or len(ohm) < FEWEST_RESISTORS:
        raise NumericsError(f"resistors of shape {ohm.shape} are no ring", remedy="give three or more")
    if not (np.isfinite(ohm).all() and (ohm > 0).all()):
        bad = int(np.flatnonzero(~(np.isfinite(ohm) & (ohm > 0)))[0])
        raise NumericsError(f"resistor {bad} of the ring has {ohm[bad]:g} Ω", remedy="it is above zero and finite")
    along = np.concatenate([[0.0], np.cumsum(ohm[:-1])])
    arc = np.abs(along[:, None] - along)
    impedance: Array = -arc * (1 - arc / ohm.sum()) / 2
    return impedance


def ring_readings(resistances_ohm: Sequence[float] | Array, pattern: DrivePattern) -> Array:
    """Readings per ampere of a ring of resistors, (drives, measures) [V/A].

    Of n equal resistors with neighbouring pairs a driven pair reads R (n − 1)/n, and every other pair −R/n.

    Raises
    ------
    NumericsError
        As :func:`ring_impedance`, or if the pattern has another number of electrodes.
    """
    impedance = ring_impedance(resistances_ohm)
    if len(impedance) != pattern.electrode_count:
        raise NumericsError(
            f"a ring of {len(impedance)} resistors does not fit a pattern of {pattern.electrode_count} electrodes",
            remedy="give one for each pair of neighbouring electrodes",
        )
    readings: Array = pattern.drive_currents().T @ impedance @ pattern.measure_matrix()
    return readings


def lead_readings(pattern: DrivePattern) -> NDArray[np.float64]:
    """What resistance in each electrode's lead adds to a reading: (drives, measures, electrodes) of −1, 0 and +1.

    A pair that is measured through a lead which carries current reads the drop over it as well: +1 where the source
    and the plus terminal, or the sink and the minus terminal, share the electrode.
    """
    added: Array = pattern.drive_currents().T[:, None, :] * pattern.measure_matrix().T[None, :, :]
    return added
