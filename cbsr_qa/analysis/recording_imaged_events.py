"""From what was found in a recording to events with their images."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.recording_images import EventImages, Sighting, Tell, prepare_for_events
from cbsr_qa.analysis.recording_overlaps import with_fates, with_imaged_places
from cbsr_qa.analysis.recording_scene import RecordedScene
from cbsr_qa.analysis.recording_tracks import motion_of
from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.image import Image
from cbsr_qa.domain.load_events import EventImaging, LoadEvent
from cbsr_qa.domain.plan import PluginChoice
from cbsr_qa.domain.reconstruction import LinearReconstruction
from cbsr_qa.interfaces import Reconstruction

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Imaged:
    """Events with their images.

    Parameters
    ----------
    imaging : how the images were made.
    remarks : what a reader must know about them, in words.
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
    """Image what was found, event by event.

    Parameters
    ----------
    sightings : of this scene, at least one.
    chosen : what ``reconstruction`` was made from.
    tell : told of each image that takes its time.

    Raises
    ------
    NumericsError, PluginError
        If the reconstruction cannot image them; names it, and the event.
    """
    sheet, offset = scene.sheet, scene.ready.offset
    images = prepare_for_events(reconstruction, chosen.name, sheet, scene.model, sightings, offset=offset)
    slow = not isinstance(images.prepared, LinearReconstruction)
    made: list[LoadEvent] = []
    for number, one in enumerate(sightings, start=1):
        if slow:
            tell(f"imaging event {number} of {len(sightings)} with {chosen.name}")
        made.append(_event(scene, one, images.of(one, _name(scene, number, one.peak_s))))

    def together(numbers: Sequence[int]) -> Array:
        tell(f"imaging event {numbers[0] + 1} together with those beside it with {chosen.name}")
        return images.together([sightings[k] for k in numbers])

    fated = with_fates(made, sheet.radius_mm, together=None if images.superposes else together)
    events = with_imaged_places(fated, sheet.radius_mm, sheet.layout)
    imaging = EventImaging(chosen, images.prepared.choice, len(sheet.problem.mesh.elements))
    alone = images.sequences and all(len(one.frames) == 1 for one in sightings)
    unknown = bool(getattr(reconstruction, "absolute", False)) and offset
    said = (*images.remarks, *_limits(chosen.name, alone=alone, unknown=unknown), *_unseen(scene, events, images))
    return Imaged(events, imaging, said)


def _name(scene: RecordedScene, number: int, peak_s: float) -> str:
    """Name an event as the report does, with its time where there is one."""
    untimed = scene.recording.still or scene.recording.clock == "none"
    return f"E{number}" if untimed else f"E{number} (at {peak_s:.1f} s)"


def _event(scene: RecordedScene, one: Sighting, values: Array) -> LoadEvent:
    radius, place = scene.sheet.radius_mm, one.place
    return LoadEvent(
        start_s=one.start_s,
        peak_s=min(max(one.peak_s, one.start_s), one.end_s),
        end_s=one.end_s,
        x_over_R=place.x,
        y_over_R=place.y,
        electrode=scene.sheet.layout.electrode_at(place.x, place.y),
        sign=one.sign,
        snr=one.score,
        image=Image(scene.sheet.problem.mesh, values),
        x_mm=place.x * radius if scene.named else None,
        y_mm=place.y * radius if scene.named else None,
        force_N=_peak_force(scene.recording.samples, one.start_s, one.end_s),
        track=one.track,
        motion=motion_of(one.track, scene.sheet.layout),
    )


def _peak_force(samples: tuple[SampleBlock, ...], start_s: float, end_s: float) -> float | None:
    force = next((block for block in samples if block.channel == "force"), None)
    if force is None:
        return None
    during = force.values[(force.time_s >= start_s) & (force.time_s <= end_s)]
    return float(during.max()) if during.size else None


def _limits(name: str, *, alone: bool, unknown: bool) -> list[str]:
    """Say what a method could not be given."""
    said = []
    if alone:
        said.append(f"{name} images consecutive frames; this recording has none, each event is an image by itself")
    if unknown:
        said.append(
            f"{name} starts from the nominal sheet: the readings are counts with an offset nobody states, so those of"
            " the unloaded sensor itself are not known"
        )
    return said


def _unseen(scene: RecordedScene, events: Sequence[LoadEvent], images: EventImages) -> list[str]:
    """Name events that the method's own image does not show: nobody shall look for them in what is left."""
    return [
        f"the image of {_name(scene, number, event.peak_s)} by {images.name} does not show it: there is no region"
        f" near its place (electrode {event.electrode:.1f}, r/R {event.r_over_R:.2f}), and what is elsewhere is not"
        " this event; choose other options or another reconstruction"
        for number, event in enumerate(events, start=1)
        if event.imaged is None
    ]
