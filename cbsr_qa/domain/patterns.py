"""Which electrode pairs are driven and which are measured, and in what canonical order frames are kept."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError


@dataclass(frozen=True, slots=True)
class DrivePattern:
    """Drive and measure pairs. A frame is stored as (drive, measure), whatever order the rig scanned in.

    Parameters
    ----------
    electrode_count : electrodes on the sensor.
    drive : pairs (source, sink), current flows in at the first.
    measure : pairs (plus, minus), the reading is U[plus] − U[minus].

    Raises
    ------
    RefusedError
        If a pair repeats, joins an electrode with itself, or names an electrode that is not there.
    """

    electrode_count: int
    drive: tuple[tuple[int, int], ...]
    measure: tuple[tuple[int, int], ...]

    def __post_init__(self) -> None:
        for kind, pairs in (("drive", self.drive), ("measure", self.measure)):
            if len(set(pairs)) != len(pairs):
                raise RefusedError(f"the {kind} pattern repeats a pair")
            for plus, minus in pairs:
                if plus == minus or not {plus, minus} <= set(range(self.electrode_count)):
                    raise RefusedError(
                        f"{kind} pair ({plus}, {minus}) is not two of electrodes 0 to {self.electrode_count - 1}"
                    )

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of one frame: (drive pairs, measure pairs)."""
        return len(self.drive), len(self.measure)

    def drive_currents(self) -> NDArray[np.float64]:
        """Unit current of each drive pair into each electrode.

        Returns
        -------
        (electrodes, drive pairs) float64 of +1, −1 and 0.
        """
        return _incidence(self.electrode_count, self.drive)

    def measure_matrix(self) -> NDArray[np.float64]:
        """Matrix that turns electrode potentials into readings: readings = potentials.T @ this.

        Returns
        -------
        (electrodes, measure pairs) float64 of +1, −1 and 0.
        """
        return _incidence(self.electrode_count, self.measure)

    def usable(self) -> NDArray[np.bool_]:
        """Readings that touch no driven electrode: 208 of 256 for adjacent/adjacent on 16.

        Returns
        -------
        (drive pairs, measure pairs) bool.
        """
        return np.array([[not set(d) & set(m) for m in self.measure] for d in self.drive])


def adjacent_pattern(electrode_count: int) -> DrivePattern:
    """Pair k joins electrodes k and k+1, for driving and for measuring alike (the rig's pattern)."""
    pairs = tuple((k, (k + 1) % electrode_count) for k in range(electrode_count))
    return DrivePattern(electrode_count, pairs, pairs)


def _incidence(electrode_count: int, pairs: tuple[tuple[int, int], ...]) -> NDArray[np.float64]:
    matrix = np.zeros((electrode_count, len(pairs)))
    for column, (plus, minus) in enumerate(pairs):
        matrix[plus, column] += 1
        matrix[minus, column] -= 1
    return matrix
