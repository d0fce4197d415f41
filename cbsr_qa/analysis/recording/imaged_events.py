"""Events of a recording with their images: places in images, merged events, and moving objects."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cbsr_qa.analysis.recording.images import EventImages, Sighting, Tell, prepare_for_events
from cbsr_qa.analysis.recording.scene import RecordedScene
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.imaging import Blob, Image, LinearReconstruction
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.results.findings import EventImaging, ImagedPlace, LoadEvent, Motion
from cbsr_qa.domain.sensor.electrodes import Electrodes
from cbsr_qa.eit.imaging.blobs import find_blobs_by_mask
from cbsr_qa.eit.imaging.multi_load import Assignment, assign_regions, split_blobs
from cbsr_qa.plugin.interfaces import Reconstruction

#: Assumed radius of an unknown head, of the sheet's (13 mm on a 100 mm disc).
_HEAD: Final = 0.13
#: Loads differ in strength: a mask that keeps those of a quarter, split where a valley of 5 % lies between.
_MASK: Final = 0.25
_VALLEY: Final = 0.05
_LARGEST: Final = 0.5  #: a region above half its peak over more than this share of the sheet gives no place


#: Images (e,) what several events, by index, change together.
Together = Callable[[Sequence[int]], Array]


def with_fates(events: Sequence[LoadEvent], radius_mm: float, together: Together) -> tuple[LoadEvent, ...]:
    """Report whether the images of simultaneous events are separate, merged or missing.

    The image combines the changes of all events present at this one's peak; its regions are those of the 25 % mask,
    split at valleys. A region belongs to an event whose place it covers, or within a head's diameter of its centre.

    Parameters
    ----------
    radius_mm : radius of the imaged sheet [mm].
    together : images the changes of several events at once.
    """
    fates = [_name_outcome(number, events, radius_mm, together) for number in range(len(events))]
    return tuple(replace(event, fate=fate) for event, fate in zip(events, fates, strict=True))


def with_imaged_places(events: Sequence[LoadEvent], radius_mm: float, layout: Electrodes) -> tuple[LoadEvent, ...]:
    """Add to every event its place in its image; None if no region is smaller than half the sheet.

    Regions are found and assigned as for fates; simultaneous events share an image.
    """
    return tuple(replace(event, imaged=_place_in_image(event, events, radius_mm, layout)) for event in events)


def _place_in_image(
    event: LoadEvent, events: Sequence[LoadEvent], radius_mm: float, layout: Electrodes
) -> ImagedPlace | None:
    image = event.image.values.tobytes()
    events_in_image = [
        other
        for other in events
        if other is not event and other.sign == event.sign and other.image.values.tobytes() == image
    ]
    values = np.maximum(event.sign * event.image.values, 0.0)
    regions, assigned = _assign_events(Image(event.image.mesh, values), [event, *events_in_image], radius_mm)
    own_region = (
        assigned.region_of[0] if assigned.merged_with[0] is None else assigned.region_of[assigned.merged_with[0]]
    )
    if own_region is None:
        return None
    own_elements = regions[own_region].elements
    x, y = (float(coordinate_mm) / radius_mm for coordinate_mm in regions[own_region].centre_mm())
    largest = float(values[own_elements].max())
    areas = event.image.mesh.areas_mm2
    share = float(areas[own_elements][values[own_elements] >= largest / 2].sum() / areas.sum())
    if share > _LARGEST:
        return None
    return ImagedPlace(x, y, layout.electrode_at(x, y), layout.count, event.sign * largest, share)


def _name_outcome(number: int, events: Sequence[LoadEvent], radius_mm: float, together: Together) -> str:
    event = events[number]
    neighbours = [k for k, other in enumerate(events) if k != number and other.start_s <= event.peak_s <= other.end_s]
    if not neighbours:
        return ""
    values = np.maximum(event.sign * together([number, *neighbours]), 0.0)
    return _assign_events(Image(event.image.mesh, values), [event, *(events[k] for k in neighbours)], radius_mm)[
        1
    ].name_outcome(0)


def _assign_events(
    image: Image, events: Sequence[LoadEvent], radius_mm: float
) -> tuple[tuple[Blob, ...], Assignment]:
    """Regions of an image with the first event's sign, and their assignment to events."""
    regions = split_blobs(find_blobs_by_mask(image, (_MASK,))[0], _VALLEY)
    head_mm = _HEAD * radius_mm
    places = [RoundFootprint(event.x_over_R * radius_mm, event.y_over_R * radius_mm, head_mm) for event in events]
    return regions, assign_regions(regions, places, gate_mm=2 * head_mm)


_LEAST_R: Final = 0.1  #: of the radius: an object that stays within it has not moved
_JITTERS: Final = 4.0  #: and so many times the scatter between frames
_FEWEST: Final = 5  #: frames
_SMOOTHED: Final = 8  #: a track is smoothed over this share of its frames, or three


def motion_of(track: tuple[tuple[float, float, float], ...], layout: Electrodes) -> Motion | None:
    """Describe how an object moves.

    Parameters
    ----------
    track : (time_s, x_over_R, y_over_R) per frame.
    layout : gives the numbering of directions.

    Returns
    -------
    None if it stays, or with fewer than five frames. It moves if, after a running median, its distance from the start
    ever exceeds a tenth of the radius and four times the scatter; the scatter is that of second differences, which
    are zero for steady motion.
    """
    places = np.array([place[1:] for place in track], dtype=np.float64).reshape(-1, 2)
    if len(places) < _FEWEST:
        return None
    # Running median of places (n, 2), with shorter windows at the ends.
    window = max(3, len(places) // _SMOOTHED)
    smooth = np.median(sliding_window_view(places, window, axis=0), axis=-1)
    jitter = float(np.sqrt(np.mean(np.diff(places, 2, axis=0) ** 2) / 6))
    if np.hypot(*(smooth - smooth[0]).T).max() < max(_LEAST_R, _JITTERS * jitter):
        return None
    numbers = np.array([layout.electrode_at(float(x), float(y)) for x, y in places])
    along = np.unwrap(numbers, period=layout.count)
    radii = np.hypot(*places.T)
    return Motion(
        begins=(float(numbers[0]), float(radii[0])),
        ends=(float(numbers[-1]), float(radii[-1])),
        turns=float(along[-1] - along[0]) / layout.count,
        nearest_r_over_R=float(np.hypot(*smooth.T).min()),
        electrodes=layout.count,
    )


@dataclass(frozen=True, slots=True)
class Imaged:
    """Events with their images.

    Parameters
    ----------
    imaging : description of how the images were made.
    remarks : notes on them for a reader.
    """

    events: tuple[LoadEvent, ...]
    imaging: EventImaging
    remarks: tuple[str, ...] = ()


def image_events(
    scene: RecordedScene,
    sightings: Sequence[Sighting],
    reconstruction: Reconstruction,
    chosen: PluginChoice,
    tell: Tell,
) -> Imaged:
    """Image the events one by one.

    Parameters
    ----------
    sightings : sightings of this scene, at least one.
    chosen : name and options of ``reconstruction``.
    tell : receives the progress of slow images.

    Raises
    ------
    NumericsError, PluginError
        If the reconstruction cannot image them; the message names it and the event.
    """
    sheet, offset = scene.sheet, scene.ready.offset or scene.recording.differences
    images = prepare_for_events(reconstruction, chosen.name, sheet, scene.model, sightings, offset=offset)
    slow = not isinstance(images.prepared, LinearReconstruction)
    imaged_events: list[LoadEvent] = []
    for number, sighting in enumerate(sightings, start=1):
        if slow:
            tell(f"imaging event {number} of {len(sightings)} with {chosen.name}")
        imaged_events.append(
            _event(scene, sighting, images.image_event(sighting, _name(scene, number, sighting.peak_s)))
        )

    def image_together(numbers: Sequence[int]) -> Array:
        if not images.superposes:
            tell(f"imaging event {numbers[0] + 1} and its neighbours with {chosen.name}")
        return images.image_together([sightings[k] for k in numbers])

    fated = with_fates(imaged_events, sheet.radius_mm, image_together)
    events = with_imaged_places(fated, sheet.radius_mm, sheet.layout)
    imaging = EventImaging(chosen, images.prepared.choice, len(sheet.problem.mesh.elements))
    single_frames = images.sequences and all(len(sighting.frames) == 1 for sighting in sightings)
    unknown = bool(getattr(reconstruction, "absolute", False)) and offset
    remarks = (
        *images.remarks,
        *_limits(chosen.name, alone=single_frames, unknown=unknown),
        *_unseen(scene, events, images),
    )
    return Imaged(events, imaging, remarks)


def _name(scene: RecordedScene, number: int, peak_s: float) -> str:
    """Name an event as in the report, with its time if known."""
    untimed = scene.recording.still or scene.recording.clock == "none"
    return f"E{number}" if untimed else f"E{number} (at {peak_s:.1f} s)"


def _event(scene: RecordedScene, seen: Sighting, values: Array) -> LoadEvent:
    radius, place = scene.sheet.radius_mm, seen.place
    return LoadEvent(
        start_s=seen.start_s,
        peak_s=min(max(seen.peak_s, seen.start_s), seen.end_s),
        end_s=seen.end_s,
        x_over_R=place.x,
        y_over_R=place.y,
        electrode=scene.sheet.layout.electrode_at(place.x, place.y),
        electrodes=scene.sheet.layout.count,
        sign=seen.sign,
        snr=seen.score,
        image=Image(scene.sheet.problem.mesh, values),
        x_mm=place.x * radius if scene.named else None,
        y_mm=place.y * radius if scene.named else None,
        force_N=_peak_force(scene.recording.samples, seen.start_s, seen.end_s),
        track=seen.track,
        motion=motion_of(seen.track, scene.sheet.layout),
        goodness=seen.goodness,
    )


def _peak_force(samples: tuple[SampleBlock, ...], start_s: float, end_s: float) -> float | None:
    force = next((block for block in samples if block.channel == "force"), None)
    if force is None:
        return None
    during = force.values[(force.time_s >= start_s) & (force.time_s <= end_s)]
    return float(during.max()) if during.size else None


def _limits(name: str, *, alone: bool, unknown: bool) -> list[str]:
    """Describe which data a method could not be given."""
    remarks = []
    if alone:
        remarks.append(f"{name} needs consecutive frames; this recording has none, so each event is imaged alone")
    if unknown:
        remarks.append(
            f"{name} starts from the nominal sheet: readings are counts with an unknown offset, or changes,"
            " so those of the unloaded sensor itself are not known"
        )
    return remarks


def _unseen(scene: RecordedScene, events: Sequence[LoadEvent], images: EventImages) -> list[str]:
    return [
        f"the image of {_name(scene, number, event.peak_s)} by {images.name} does not show it: no region lies"
        f" near its place ({event.place}), and regions elsewhere are not"
        " this event; use other options or another reconstruction"
        for number, event in enumerate(events, start=1)
        if event.imaged is None
    ]
