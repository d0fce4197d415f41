"""Positions and numbering of electrodes.

Whether electrodes fit a sheet: inside it or on its edge, and clear of each other.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Final

import numpy as np

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.geometry.outlines import Disc, SheetOutline
from cbsr_qa.domain.kept import Kept
from cbsr_qa.domain.numbers import Array


class ElectrodeKind(StrEnum):
    """Kind of electrode contact."""

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

    def angles_rad(self) -> Array:
        """Directions of the electrodes, counterclockwise from +x.

        Returns
        -------
        (count,) float64 [rad].
        """
        first_rad = float(np.deg2rad(self.first_angle_deg))
        return first_rad + self.step_rad * np.arange(self.count, dtype=np.float64)

    def positions_mm(self) -> Array:
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
    """Electrodes at individual positions. Two make a strip for characterising a material, not for images.

    Parameters
    ----------
    kind : pins through the sheet or strips along its edge.
    places_mm : centre of each, relative to the sheet's centre; a strip's lies on the edge.
    width_mm : a pin's diameter, or a strip's length along the edge.
    """

    kind: ElectrodeKind
    places_mm: Annotated[tuple[tuple[float, float], ...], Kept("positions")]
    width_mm: float

    def __post_init__(self) -> None:
        if self.count < 2:
            raise RefusedError(f"electrodes.positions_mm has {self.count} positions; at least 2 are needed")
        if not 0 < self.width_mm < float("inf"):
            raise RefusedError(f"electrode width is {self.width_mm} mm; it must be positive and finite")
        if not np.isfinite(self.places_mm).all():
            raise RefusedError("an electrode position is not a finite number")

    @property
    def count(self) -> int:
        return len(self.places_mm)

    def positions_mm(self) -> Array:
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
        electrode_after, electrode_before = int(ahead.argmin()), int(ahead.argmax())
        gap = ahead[electrode_after] + 2 * np.pi - ahead[electrode_before]
        share = 1 - float(ahead[electrode_after] / gap) if gap > 0 else 0.0
        step = (electrode_after - electrode_before + self.count // 2) % self.count - self.count // 2
        if abs(step) == 1:
            return (electrode_before + step * share) % self.count
        return float(electrode_after if share > 0.5 else electrode_before)


#: Electrodes by either kind of layout.
Electrodes = ElectrodeLayout | PlacedElectrodes


#: Largest distance of the stated centre of a strip from the edge, as a share of its length.
_OFF_EDGE: Final = 0.05
#: Least room between a pin and the edge or another pin, of its diameter: elements have to fit in, and go round.
LEAST_ROOM: Final = 0.05
#: Least room between strips, of their length.
LEAST_STRIP_ROOM: Final = 1e-3
#: Least width of an electrode, of the sheet's radius: elements grow from it to the sheet's own.
LEAST_WIDTH: Final = 1e-3


def placement_problems(electrodes: Electrodes, outline: SheetOutline) -> Iterator[tuple[int | None, str]]:
    """Yield problems of electrodes on a sheet: the electrode (None for a whole ring) and a description.

    Equally spaced arcs belong to a disc; all other electrodes are checked one by one.
    """
    if isinstance(electrodes, PlacedElectrodes):
        check = _pins if electrodes.kind is ElectrodeKind.PIN else _strips
        yield from check(electrodes, outline)
    elif not isinstance(outline, Disc):
        if electrodes.kind is ElectrodeKind.ARC:
            yield None, "equally spaced arcs need a disc; on another outline give the position of each electrode"
        else:
            yield from _pins(electrodes, outline)


def width_problem(electrodes: Electrodes, radius_mm: float) -> str | None:
    """Problem of the electrodes' width on a sheet of this radius, or of the gaps it leaves on a ring."""
    width = electrodes.width_mm
    if width < LEAST_WIDTH * radius_mm:
        return (
            f"is {width:g}; on this sheet it must be at least {LEAST_WIDTH * radius_mm:.3g} mm, a thousandth of its"
            " radius"
        )
    if not isinstance(electrodes, ElectrodeLayout):
        return None
    if electrodes.kind is ElectrodeKind.PIN:
        room, pitch = LEAST_ROOM, 2 * electrodes.ring_radius_mm * float(np.sin(np.pi / electrodes.count))
    else:
        room, pitch = LEAST_STRIP_ROOM, 2 * np.pi * electrodes.ring_radius_mm / electrodes.count
    if width * (1 + room) <= pitch:
        return None
    return (
        f"is {width:g}; electrodes whose centres are {pitch:.4g} mm apart are at most {pitch / (1 + room):.6g} mm"
        f" wide, with a gap of {room:g} of the width"
    )


def widest_ring_mm(width_mm: float, radius_mm: float) -> float:
    """Radius of the widest ring of pins on a disc [mm]."""
    return radius_mm - width_mm * (0.5 + LEAST_ROOM)


def _pins(electrodes: Electrodes, outline: SheetOutline) -> Iterator[tuple[int, str]]:
    places, width = electrodes.positions_mm(), electrodes.width_mm
    clearance = outline.clearance_mm(places)
    for number, room in enumerate(clearance):
        if room < 0:
            yield number, f"lies {-room:.4g} mm outside the sheet"
        elif room < width * (0.5 + LEAST_ROOM):
            needed = width * (0.5 + LEAST_ROOM)
            yield number, f"lies {room:.4g} mm from the edge; a pin of {width:g} mm needs {needed:g} mm"
    for number, place in enumerate(places):
        pitch = np.hypot(*(places[:number] - place).T)
        if pitch.size and pitch.min() <= width:
            near = int(pitch.argmin())
            yield number, f"overlaps electrode {near}: their centres are {pitch[near]:.4g} mm apart"
        elif pitch.size and pitch.min() < width * (1 + LEAST_ROOM):
            near, needed = int(pitch.argmin()), width * (1 + LEAST_ROOM)
            yield (
                number,
                f"is too close to electrode {near}: between centres are {pitch[near]:.8g} mm, pins of {width:g} mm"
                f" need {needed:g} mm",
            )


def _strips(electrodes: PlacedElectrodes, outline: SheetOutline) -> Iterator[tuple[int, str]]:
    curve, width = outline.curve, electrodes.width_mm
    along, off = curve.nearest(electrodes.positions_mm())
    for number, distance in enumerate(off):
        if distance > _OFF_EDGE * width:
            yield number, f"lies {distance:.4g} mm from the edge, where its centre must be"
    for number, place in enumerate(along):
        pitch = np.abs(along[:number] - place)
        pitch = np.minimum(pitch, curve.perimeter - pitch)
        if pitch.size and pitch.min() <= width:
            near = int(pitch.argmin())
            yield (
                number,
                f"overlaps electrode {near}: their centres are {pitch[near]:.4g} mm apart along the edge",
            )
        elif pitch.size and pitch.min() < width * (1 + LEAST_STRIP_ROOM):
            near, needed = int(pitch.argmin()), width * (1 + LEAST_STRIP_ROOM)
            yield (
                number,
                f"is too close to electrode {near}: between centres are {pitch[near]:.8g} mm along the edge, strips"
                f" of {width:g} mm need {needed:g} mm",
            )
    if width >= curve.perimeter / 2:
        yield 0, f"is {width:g} mm long; it must be less than half the edge"
