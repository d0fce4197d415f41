"""Heads and loads: what presses on the sheet, where, how hard, when."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Final, Self

import numpy as np

from cbsr_qa.domain.geometry.footprints import Footprint, PolygonFootprint, RoundFootprint
from cbsr_qa.domain.kept import Kept


@dataclass(frozen=True, slots=True)
class Indenter:
    """Flat head of the force applicator, round or of any outline.

    Parameters
    ----------
    diameter_mm : diameter of a round head [mm]; of the disc of the same area for another, see :meth:`with_outline`.
    outline_mm : corners (x, y) from the head's axis, counterclockwise; empty for a round head.
    """

    diameter_mm: float
    outline_mm: Annotated[tuple[tuple[float, float], ...], Kept(omitted=True)] = ()

    @classmethod
    def with_outline(cls, corners_mm: Iterable[tuple[float, float]]) -> Self:
        """Return a head of any outline.

        Raises
        ------
        NumericsError
            If the corners do not make a simple polygon.
        """
        polygon = PolygonFootprint(np.array(list(corners_mm), dtype=np.float64))
        corners = tuple((x, y) for x, y in polygon.corners_mm.tolist())
        return cls(2 * float(np.sqrt(polygon.area_mm2 / np.pi)), corners)

    @property
    def radius_mm(self) -> float:
        """Radius r of the head; of the disc of equal area if it is not round."""
        return self.diameter_mm / 2

    @property
    def area_mm2(self) -> float:
        """Area A_FA of the head (132.7 mm² for 13 mm; the paper rounds to 133)."""
        return float(np.pi * self.radius_mm**2)

    @property
    def squared_radius_mm2(self) -> float:
        """Squared radius of the disc with the head's second moment, 2⟨r²⟩ about its axis [mm²]; r² of a round one."""
        if not self.outline_mm:
            return self.radius_mm**2
        corner = np.array(self.outline_mm)
        next_corner = np.roll(corner, -1, axis=0)
        cross = corner[:, 0] * next_corner[:, 1] - corner[:, 1] * next_corner[:, 0]
        moment = cross @ (corner**2 + corner * next_corner + next_corner**2).sum(axis=1) / 12
        return 2 * float(moment) / self.area_mm2

    @property
    def reach_mm(self) -> float:
        """Furthest point of the head from its axis."""
        return max((float(np.hypot(*corner)) for corner in self.outline_mm), default=self.radius_mm)

    def footprint_at(self, x_mm: float, y_mm: float) -> Footprint:
        """Return the head's outline with its axis at a place of the sheet."""
        if not self.outline_mm:
            return RoundFootprint(x_mm, y_mm, self.radius_mm)
        return PolygonFootprint(np.array(self.outline_mm) + np.array([x_mm, y_mm]))

    def scale(self, factor: float) -> Self:
        return type(self)(factor * self.diameter_mm, tuple((factor * x, factor * y) for x, y in self.outline_mm))

    def words(self) -> str:
        """Describe the head, e.g. ``"13 mm diameter"``."""
        if not self.outline_mm:
            return f"{self.diameter_mm:g} mm diameter"
        return f"outline of {len(self.outline_mm)} corners, {2 * self.reach_mm:.3g} mm across"


@dataclass(frozen=True, slots=True)
class Load:
    """One planned press.

    Parameters
    ----------
    label : ``"L0"`` … ``"L8"`` on the grid, ``"R0"`` … for random loads.
    x_mm, y_mm : axis of the indenter relative to the sheet's centre.
    strain : compressive, as a fraction (0.2 is 20 %).
    trial : 0-based repetition of the same load.
    """

    label: str
    x_mm: float
    y_mm: float
    strain: float
    trial: int


@dataclass(frozen=True, slots=True)
class EasedStrain:
    """Another strain of a press, reached without leaving the sheet.

    Parameters
    ----------
    strain : strain as a fraction.
    start_s, hold_start_s : the head starts to move there, and is there. It is held until the next one starts, or the
        release does.
    """

    strain: float
    start_s: float
    hold_start_s: float


@dataclass(frozen=True, slots=True)
class HeldStrain:
    """One strain of a press, from the head's arrival to its next move [s]."""

    strain: float
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class LoadRecord:
    """One press as it happened, on the run's clock [s].

    Only presses that were held to the end become records: an unfinished one is repeated on resume.

    Parameters
    ----------
    index : 0-based within its phase.
    load : load as it was pressed first.
    press_start_s … rest_end_s : the head starts down, is down, starts up, is up, the rest is over.
    clear_s : the head has left the sheet, on its way up; None if not recorded (recordings of others).
    eased : the strains it was brought to after the first one, in order; none for an ordinary press.
    """

    index: int
    load: Load
    press_start_s: float
    hold_start_s: float
    release_start_s: float
    release_end_s: float
    rest_end_s: float
    clear_s: float | None = None
    eased: tuple[EasedStrain, ...] = ()

    @property
    def held(self) -> tuple[HeldStrain, ...]:
        """All strains of the press in order, the first one included, with start and end of each hold."""
        strains = (self.load.strain, *(step.strain for step in self.eased))
        starts = (self.hold_start_s, *(step.hold_start_s for step in self.eased))
        ends = (*(step.start_s for step in self.eased), self.release_start_s)
        return tuple(HeldStrain(*times_of_hold) for times_of_hold in zip(strains, starts, ends, strict=True))

    @property
    def unloaded_s(self) -> float:
        """End of the unloading ramp: the head left the sheet, or is known to be up [s]."""
        return self.release_end_s if self.clear_s is None else self.clear_s


#: Turns between neighbouring places of a sunflower: the golden angle.
GOLDEN_TURN: Final = 2 - (1 + 5**0.5) / 2


def sunflower_mm(count: int, radius_mm: float) -> tuple[tuple[float, float], ...]:
    """Places spread evenly over a disc: the k-th of n at radius R √((k + ½)/n) and k golden angles, to 0.1 mm.

    Each lies across the disc from the one before it, far from its residue.
    """
    number = np.arange(count)
    radius, turn = radius_mm * np.sqrt((number + 0.5) / count), 2 * np.pi * GOLDEN_TURN * number
    places = np.round(np.column_stack([radius * np.cos(turn), radius * np.sin(turn)]), 1) + 0.0  # no −0
    return tuple((float(x), float(y)) for x, y in places)


#: The nine locations of the paper's Fig 2, in the rig's order [mm].
NINE_LOCATIONS_MM: tuple[tuple[float, float], ...] = (
    (0.0, 0.0),
    (30.0, 0.0),
    (-30.0, 0.0),
    (15.0, 15.0),
    (-15.0, 15.0),
    (15.0, -15.0),
    (-15.0, -15.0),
    (0.0, 30.0),
    (0.0, -30.0),
)
