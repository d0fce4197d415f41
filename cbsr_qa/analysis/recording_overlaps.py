"""Events that overlap in time: whether the image still shows each as a region of its own."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cbsr_qa.domain.footprints import RoundFootprint
from cbsr_qa.domain.image import Image
from cbsr_qa.domain.load_events import LoadEvent
from cbsr_qa.imaging.blobs import masked_blobs
from cbsr_qa.imaging.several_loads import assign_regions
from cbsr_qa.imaging.watershed import split_blobs

#: Nobody says what pressed: a head of this radius, of the sheet's (13 mm on a 100 mm disc).
_HEAD: Final = 0.13
#: Loads differ in strength: a mask that keeps those of a quarter, parted where a valley of 5 % lies between.
_MASK: Final = 0.25
_VALLEY: Final = 0.05


def with_fates(events: Sequence[LoadEvent], radius_mm: float) -> tuple[LoadEvent, ...]:
    """Say of every event beside others whether it is apart from them in the image, merged with one, or missed.

    The image is the sum of the changes of the events that last at this one's peak, each once; a region is one of its
    25 % mask, parted at valleys. It belongs to an event whose place it covers, or whose centre is a head's diameter
    away at most.

    Parameters
    ----------
    radius_mm : of the sheet the images are of.
    """
    return tuple(replace(event, fate=_fate(event, events, radius_mm)) for event in events)


def _fate(event: LoadEvent, events: Sequence[LoadEvent], radius_mm: float) -> str:
    beside = [other for other in events if other is not event and other.start_s <= event.peak_s <= other.end_s]
    if not beside:
        return ""
    together = [event, *beside]
    # What was pressed at once has one change between it.
    changes = {one.image.values.tobytes(): one.image.values for one in together}
    values = np.maximum(event.sign * np.sum(list(changes.values()), axis=0), 0.0)
    regions = split_blobs(masked_blobs(Image(event.image.mesh, values), (_MASK,))[0], _VALLEY)
    head_mm = _HEAD * radius_mm
    places = [RoundFootprint(one.x_over_R * radius_mm, one.y_over_R * radius_mm, head_mm) for one in together]
    return assign_regions(regions, places, gate_mm=2 * head_mm).fate(0)
