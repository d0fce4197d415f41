"""Whether electrodes fit a sheet: inside it or on its edge, and clear of each other."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.electrodes import ElectrodeKind, ElectrodeLayout, Electrodes, PlacedElectrodes
from cbsr_qa.domain.outlines import Disc, SheetOutline

#: How far from the edge the stated centre of a strip may lie, of its length.
_OFF_EDGE: Final = 0.05
#: Least room between a pin and the edge or another pin, of its diameter: elements have to fit in, and go round.
LEAST_ROOM: Final = 0.05
#: Least room between strips, of their length.
LEAST_STRIP_ROOM: Final = 1e-3
#: Least width of an electrode, of the sheet's radius: elements grow from it to the sheet's own.
LEAST_WIDTH: Final = 1e-3


def placement_problems(electrodes: Electrodes, outline: SheetOutline) -> Iterator[tuple[int | None, str]]:
    """Yield what keeps electrodes from fitting a sheet: which one (None for all of a ring), and what.

    Equally spaced arcs belong to a disc; every other combination of electrodes and outline is looked at one by one.
    """
    if isinstance(electrodes, PlacedElectrodes):
        check = _pins if electrodes.kind is ElectrodeKind.PIN else _strips
        yield from check(electrodes, outline)
    elif not isinstance(outline, Disc):
        if electrodes.kind is ElectrodeKind.ARC:
            yield None, "equally spaced arcs lie on a disc; on another outline each electrode needs a position"
        else:
            yield from _pins(electrodes, outline)


def width_problem(electrodes: Electrodes, radius_mm: float) -> str | None:
    """What is wrong with electrodes' width on a sheet of this radius, or with the room it leaves on a ring."""
    width = electrodes.width_mm
    if width < LEAST_WIDTH * radius_mm:
        return (
            f"is {width:g}; on this sheet it must be at least {LEAST_WIDTH * radius_mm:.3g} mm, a thousandth of its"
            " radius"
        )
    if not isinstance(electrodes, ElectrodeLayout):
        return None
    if electrodes.kind is ElectrodeKind.PIN:
        room, apart = LEAST_ROOM, 2 * electrodes.ring_radius_mm * float(np.sin(np.pi / electrodes.count))
    else:
        room, apart = LEAST_STRIP_ROOM, 2 * np.pi * electrodes.ring_radius_mm / electrodes.count
    if width * (1 + room) <= apart:
        return None
    return (
        f"is {width:g}; electrodes whose centres are {apart:.4g} mm apart are at most {apart / (1 + room):.6g} mm"
        f" wide, with {room:g} of that between them"
    )


def widest_ring_mm(width_mm: float, radius_mm: float) -> float:
    """Radius of the widest ring of pins on a disc [mm]."""
    return radius_mm - width_mm * (0.5 + LEAST_ROOM)


def strip_centres_mm(electrodes: PlacedElectrodes, outline: SheetOutline) -> NDArray[np.float64]:
    """Lengths along the edge at which the strips' centres lie, (count,) [mm]."""
    return outline.curve.nearest(electrodes.positions_mm())[0]


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
        apart = np.hypot(*(places[:number] - place).T)
        if apart.size and apart.min() <= width:
            other = int(apart.argmin())
            yield number, f"overlaps electrode {other}: their centres are {apart[other]:.4g} mm apart"
        elif apart.size and apart.min() < width * (1 + LEAST_ROOM):
            other, needed = int(apart.argmin()), width * (1 + LEAST_ROOM)
            yield (
                number,
                f"is too close to electrode {other}: between centres are {apart[other]:.8g} mm, pins of {width:g} mm"
                f" need {needed:g} mm",
            )


def _strips(electrodes: PlacedElectrodes, outline: SheetOutline) -> Iterator[tuple[int, str]]:
    curve, width = outline.curve, electrodes.width_mm
    along, off = curve.nearest(electrodes.positions_mm())
    for number, distance in enumerate(off):
        if distance > _OFF_EDGE * width:
            yield number, f"lies {distance:.4g} mm from the edge, on which the centre of a strip belongs"
    for number, place in enumerate(along):
        apart = np.abs(along[:number] - place)
        apart = np.minimum(apart, curve.perimeter - apart)
        if apart.size and apart.min() <= width:
            other = int(apart.argmin())
            yield (
                number,
                f"overlaps electrode {other}: their centres are {apart[other]:.4g} mm apart along the edge",
            )
        elif apart.size and apart.min() < width * (1 + LEAST_STRIP_ROOM):
            other, needed = int(apart.argmin()), width * (1 + LEAST_STRIP_ROOM)
            yield (
                number,
                f"is too close to electrode {other}: between centres are {apart[other]:.8g} mm along the edge, strips"
                f" of {width:g} mm need {needed:g} mm",
            )
    if width >= curve.perimeter / 2:
        yield 0, f"is {width:g} mm long, half the edge or more"
