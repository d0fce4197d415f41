"""Whether electrodes fit a sheet: inside it or on its edge, and clear of each other."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.electrodes import ElectrodeKind, Electrodes, PlacedElectrodes
from cbsr_qa.domain.outlines import Disc, SheetOutline

#: How far from the edge the stated centre of a strip may lie, of its length.
_OFF_EDGE: Final = 0.05


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


def strip_centres_mm(electrodes: PlacedElectrodes, outline: SheetOutline) -> NDArray[np.float64]:
    """Lengths along the edge at which the strips' centres lie, (count,) [mm]."""
    return outline.curve.nearest(electrodes.positions_mm())[0]


def _pins(electrodes: Electrodes, outline: SheetOutline) -> Iterator[tuple[int, str]]:
    places, width = electrodes.positions_mm(), electrodes.width_mm
    clearance = outline.clearance_mm(places)
    for number, room in enumerate(clearance):
        if room < 0:
            yield number, f"lies {-room:.4g} mm outside the sheet"
        elif room <= width / 2:
            yield number, f"lies {room:.4g} mm from the edge; a pin of {width:g} mm needs more than {width / 2:g} mm"
    for number, place in enumerate(places):
        apart = np.hypot(*(places[:number] - place).T)
        if apart.size and apart.min() <= width:
            other = int(apart.argmin())
            yield number, f"overlaps electrode {other}: their centres are {apart[other]:.4g} mm apart"


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
    if width >= curve.perimeter / 2:
        yield 0, f"is {width:g} mm long, half the edge or more"
