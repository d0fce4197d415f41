"""Where the electrodes are and how they are counted."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError


class ElectrodeKind(StrEnum):
    """How an electrode touches the sheet."""

    PIN = "pin"  #: a metal pin through the sheet, contact impedance on its rim
    ARC = "arc"  #: a strip along the sheet's edge


@dataclass(frozen=True, slots=True)
class ElectrodeLayout:
    """Equally spaced electrodes on a ring.

    Parameters
    ----------
    count : number of electrodes, at least 3.
    kind : pins through the sheet or arcs on its edge.
    ring_radius_mm : radius of the circle through the electrodes' centres.
    width_mm : a pin's diameter, or an arc's length along the edge.
    first_angle_deg : direction of electrode 0, counterclockwise from +x.
    counterclockwise : whether the numbers rise counterclockwise.
    """

    count: int
    kind: ElectrodeKind
    ring_radius_mm: float
    width_mm: float
    first_angle_deg: float
    counterclockwise: bool

    def __post_init__(self) -> None:
        if self.count < 3:
            raise RefusedError(f"electrodes.count is {self.count}; at least 3 are needed")
        spacing_mm = 2 * np.pi * self.ring_radius_mm / self.count
        if not 0 < self.width_mm < spacing_mm:
            raise RefusedError(
                f"electrodes.width_mm is {self.width_mm}; it must be above 0"
                f" and below the spacing of {spacing_mm:.2f} mm"
            )

    @property
    def step_rad(self) -> float:
        """Signed angle from one electrode to the next [rad]."""
        return (1 if self.counterclockwise else -1) * 2 * np.pi / self.count

    def angles_rad(self) -> NDArray[np.float64]:
        """Directions of the electrodes, counterclockwise from +x.

        Returns
        -------
        (count,) float64 [rad].
        """
        first_rad = float(np.deg2rad(self.first_angle_deg))
        angles: NDArray[np.float64] = first_rad + self.step_rad * np.arange(self.count, dtype=np.float64)
        return angles

    def positions_mm(self) -> NDArray[np.float64]:
        """Centres of the electrodes.

        Returns
        -------
        (count, 2) float64 [mm], relative to the sheet's centre.
        """
        angles = self.angles_rad()
        return self.ring_radius_mm * np.column_stack([np.cos(angles), np.sin(angles)])

    def electrode_at(self, x: float, y: float) -> float:
        """Direction of a place as a fractional electrode number in [0, count).

        Parameters
        ----------
        x, y : any one unit of length, relative to the sheet's centre.
        """
        angle = np.arctan2(y, x) - np.deg2rad(self.first_angle_deg)
        return float((angle / self.step_rad) % self.count)
