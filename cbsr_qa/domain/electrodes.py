"""Where the electrodes are and how they are counted."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError


class ElectrodeKind(StrEnum):
    """How an electrode touches the sheet."""

    PIN = "pin"  #: a metal pin through the sheet, contact impedance on its rim
    ARC = "arc"  #: a strip along the sheet's edge, straight where the edge is, round a corner where it is on one


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


@dataclass(frozen=True, slots=True)
class PlacedElectrodes:
    """Electrodes one by one, wherever they are. Two make a strip for characterising a material, not for images.

    Parameters
    ----------
    kind : pins through the sheet or strips along its edge.
    places_mm : centre of each, relative to the sheet's centre; a strip's lies on the edge.
    width_mm : a pin's diameter, or a strip's length along the edge.
    """

    kind: ElectrodeKind
    places_mm: tuple[tuple[float, float], ...]
    width_mm: float

    def __post_init__(self) -> None:
        if self.count < 2:
            raise RefusedError(f"electrodes.positions_mm has {self.count} electrodes; at least 2 are needed")
        if not 0 < self.width_mm < float("inf"):
            raise RefusedError(f"the width of electrodes is {self.width_mm} mm; it must be a positive number")
        if not np.isfinite(self.places_mm).all():
            raise RefusedError("the position of an electrode is not a finite number")

    @property
    def count(self) -> int:
        """Number of electrodes."""
        return len(self.places_mm)

    def positions_mm(self) -> NDArray[np.float64]:
        """Centres of the electrodes.

        Returns
        -------
        (count, 2) float64 [mm], relative to the sheet's centre.
        """
        return np.array(self.places_mm, dtype=np.float64)

    def electrode_at(self, x: float, y: float) -> float:
        """Direction of a place as a fractional electrode number in [0, count).

        Between electrodes whose directions from the sheet's centre follow each other it is interpolated by angle
        where their numbers follow each other too; elsewhere it is the number of the nearer one.

        Parameters
        ----------
        x, y : any one unit of length, relative to the sheet's centre.
        """
        place = self.positions_mm()
        directions = np.arctan2(place[:, 1], place[:, 0])
        ahead = (directions - np.arctan2(y, x)) % (2 * np.pi)
        after, before = int(ahead.argmin()), int(ahead.argmax())
        gap = ahead[after] + 2 * np.pi - ahead[before]
        share = 1 - float(ahead[after] / gap) if gap > 0 else 0.0
        step = (after - before + self.count // 2) % self.count - self.count // 2
        if abs(step) == 1:
            return (before + step * share) % self.count
        return float(after if share > 0.5 else before)


#: Either way to say where electrodes are.
Electrodes = ElectrodeLayout | PlacedElectrodes
