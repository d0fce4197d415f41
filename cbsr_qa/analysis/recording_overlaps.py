"""Where images show events, and whether those that overlap in time each still have a region of their own."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.electrodes import Electrodes
from cbsr_qa.domain.footprints import RoundFootprint
from cbsr_qa.domain.image import Blob, Image
from cbsr_qa.domain.load_events import ImagedPlace, LoadEvent
from cbsr_qa.imaging.blobs import masked_blobs
from cbsr_qa.imaging.several_loads import Assignment, assign_regions
from cbsr_qa.imaging.watershed import split_blobs

Array = NDArray[np.float64]

#: Nobody says what pressed: a head of this radius, of the sheet's (13 mm on a 100 mm disc).
_HEAD: Final = 0.13
#: Loads differ in strength: a mask that keeps those of a quarter, parted where a valley of 5 % lies between.
_MASK: Final = 0.25
_VALLEY: Final = 0.05
_LARGEST: Final = 0.5  #: a region above half its peak over more than this share of the sheet says no place


#: Makes one image (e,) of what several events, by number, change together.
Together = Callable[[Sequence[int]], Array]


def with_fates(
    events: Sequence[LoadEvent], radius_mm: float, *, together: Together | None = None
) -> tuple[LoadEvent, ...]:
    """Say of every event beside others whether it is apart from them in the image, merged with one, or missed.

    The image is that of the changes of the events that last at this one's peak, each once; a region is one of its
    25 % mask, parted at valleys. It belongs to an event whose place it covers, or whose centre is a head's diameter
    away at most.

    Parameters
    ----------
    radius_mm : of the sheet the images are of.
    together : images several changes at once; None for the sum of their images, which is the same for linear methods.
    """

    def summed(numbers: Sequence[int]) -> Array:
        # What was pressed at once has one change between it.
        images = {events[k].image.values.tobytes(): events[k].image.values for k in numbers}
        total: Array = np.sum(list(images.values()), axis=0)
        return total

    fates = [_fate(number, events, radius_mm, together or summed) for number in range(len(events))]
    return tuple(replace(event, fate=fate) for event, fate in zip(events, fates, strict=True))


def with_imaged_places(events: Sequence[LoadEvent], radius_mm: float, layout: Electrodes) -> tuple[LoadEvent, ...]:
    """Say of every event where its own image shows it; nowhere, if no region smaller than half the sheet is there.

    Regions are found and assigned as for fates; what was pressed at once shares an image.
    """
    return tuple(replace(event, imaged=_imaged(event, events, radius_mm, layout)) for event in events)


def _imaged(
    event: LoadEvent, events: Sequence[LoadEvent], radius_mm: float, layout: Electrodes
) -> ImagedPlace | None:
    image = event.image.values.tobytes()
    beside = [
        one for one in events if one is not event and one.sign == event.sign and one.image.values.tobytes() == image
    ]
    values = np.maximum(event.sign * event.image.values, 0.0)
    regions, assigned = _assigned(Image(event.image.mesh, values), [event, *beside], radius_mm)
    own = assigned.region_of[0] if assigned.merged_with[0] is None else assigned.region_of[assigned.merged_with[0]]
    if own is None:
        return None
    inside = regions[own].elements
    x, y = (float(at) / radius_mm for at in regions[own].centre_mm())
    largest = float(values[inside].max())
    areas = event.image.mesh.areas_mm2
    share = float(areas[inside][values[inside] >= largest / 2].sum() / areas.sum())
    if share > _LARGEST:
        return None
    return ImagedPlace(x, y, layout.electrode_at(x, y), event.sign * largest, share)


def _fate(number: int, events: Sequence[LoadEvent], radius_mm: float, together: Together) -> str:
    event = events[number]
    beside = [k for k, other in enumerate(events) if k != number and other.start_s <= event.peak_s <= other.end_s]
    if not beside:
        return ""
    values = np.maximum(event.sign * together([number, *beside]), 0.0)
    return _assigned(Image(event.image.mesh, values), [event, *(events[k] for k in beside)], radius_mm)[1].fate(0)


def _assigned(image: Image, events: Sequence[LoadEvent], radius_mm: float) -> tuple[tuple[Blob, ...], Assignment]:
    """Regions of an image of what conducts as the first event does, and which belongs to which event."""
    regions = split_blobs(masked_blobs(image, (_MASK,))[0], _VALLEY)
    head_mm = _HEAD * radius_mm
    places = [RoundFootprint(one.x_over_R * radius_mm, one.y_over_R * radius_mm, head_mm) for one in events]
    return regions, assign_regions(regions, places, gate_mm=2 * head_mm)
