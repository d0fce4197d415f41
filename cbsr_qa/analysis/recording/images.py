"""Images of a recording's events, by the chosen reconstruction.

Events are detected without images, by matching the patterns of loads in the readings (:mod:`places`). Only the change
of each event is imaged, not every frame, so that a method may take a second per image. A method receives what it
requests (``Reconstruction``): changes by default, the frames around an event if its images
depend on their neighbours, the unloaded readings if its images are absolute.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from cbsr_qa.analysis.recording.imaging import Sheet, UnitModel, plain_model
from cbsr_qa.analysis.recording.places import Place
from cbsr_qa.domain.errors import CbsrError, NumericsError, PluginError
from cbsr_qa.domain.goodness import Goodness
from cbsr_qa.domain.imaging import ImagingProblem, LinearReconstruction, PreparedReconstruction
from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin.interfaces import Reconstruction
from cbsr_qa.system.copies import end_forked_copies

#: Function that receives each step, in words.
Tell = Callable[[str], None]

_REMEDY: Final = "use other options or another reconstruction; the default is gauss-newton-noser"
_MOST_FRAMES: Final = 256  #: frames of a hold, and before it, that a method for sequences receives


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A detected event, before imaging.

    Parameters
    ----------
    start_s, peak_s, end_s : start, peak and end on the recording's clock [s].
    score : detection statistic over its noise.
    change : (m,) changes of the used readings, scaled to the unit model.
    frames : (k, m) changes of consecutive frames around it, scaled alike; ``held`` marks those that show it.
    unloaded : (m,) used readings it is compared with, in the recording's unit.
    goodness : goodness of the fit of this load and of others that changed with it.
    track : times and places (time_s, x, y) of an object that moves.
    """

    start_s: float
    peak_s: float
    end_s: float
    place: Place
    score: float
    change: Array
    frames: Array
    held: slice
    unloaded: Array
    goodness: Goodness
    track: tuple[tuple[float, float, float], ...] = ()

    @property
    def sign(self) -> int:
        """+1 where the place conducts more, −1 less."""
        return 1 if self.place.score > 0 else -1


def frames_around(changes: Array, before: slice, held: slice) -> tuple[Array, slice]:
    """Cut the frames around a press, relative to those before it.

    Parameters
    ----------
    changes : (n, m), evenly spaced.
    before, held : frames of the reference and of the hold, in either order.

    Returns
    -------
    (k, m) at most some 1000 consecutive frames next to the step, and which of them belong to the hold.
    """
    first, last = sorted((before, held), key=lambda part: part.start)
    begin, end = max(first.start, first.stop - _MOST_FRAMES), min(last.stop, last.start + _MOST_FRAMES)
    if end - begin > 4 * _MOST_FRAMES:  # a press that took that long to rise
        begin, end = held.start, min(held.stop, held.start + _MOST_FRAMES)
    frames = changes[begin:end] - changes[before].mean(axis=0)
    return frames, slice(max(held.start - begin, 0), min(held.stop, end) - begin)


def nearest_frames(changes: Array, frame: int) -> tuple[Array, int]:
    """Frames around one of (n, m): at most 513, and its index among them."""
    begin = max(frame - _MOST_FRAMES, 0)
    return changes[begin : frame + _MOST_FRAMES + 1], frame - begin


@dataclass(slots=True, eq=False)
class EventImages:
    """A reconstruction prepared for a recording's events.

    Parameters
    ----------
    name : name of the reconstruction, for messages.
    gain : (m,) from the unit model's changes to those that the method was prepared for.
    sequences : whether it receives the frames around an event.
    remarks : notes on its preparation for a reader.
    """

    name: str
    prepared: PreparedReconstruction
    gain: Array
    sequences: bool
    remarks: tuple[str, ...] = ()
    _made: dict[bytes, Array] = field(default_factory=dict)

    def image_event(self, sighting: Sighting, name: str = "an event") -> Array:
        """Image (e,) of an event's change; messages name the event ``name``."""
        problem = f"{self.name} cannot image {name}"
        if self.sequences:
            image: Array = self._images(problem, sighting.frames)[sighting.held].mean(axis=0)
        else:
            image = self._images(problem, sighting.change[None])[0]
        return image

    def image_together(self, sightings: Sequence[Sighting]) -> Array:
        """Image (e,) of the changes of several events, each counted once."""
        changes = {sighting.change.tobytes(): sighting for sighting in sightings}.values()
        if self.superposes:
            total: Array = np.sum([self.image_event(sighting) for sighting in changes], axis=0)
            return total
        problem = f"{self.name} cannot image the {len(changes)} changes up to {sightings[0].peak_s:.1f} s together"
        image: Array = self._images(problem, np.sum([sighting.change for sighting in changes], axis=0)[None])[0]
        return image

    @property
    def superposes(self) -> bool:
        """Whether the method is linear."""
        return isinstance(self.prepared, LinearReconstruction) or bool(getattr(self.prepared, "linear", False))

    def _images(self, where: str, changes: Array) -> Array:
        key = changes.tobytes()
        if key not in self._made:
            with _convert_errors(where):
                images = self.prepared.images(changes * self.gain)
                self._made[key] = _check_images(images, (len(changes), len(self.prepared.problem.mesh.elements)))
        return self._made[key]


def prepare_for_events(
    reconstruction: Reconstruction,
    name: str,
    sheet: Sheet,
    model: UnitModel,
    sightings: Sequence[Sighting],
    *,
    offset: bool,
) -> EventImages:
    """Prepare a reconstruction for detected events.

    Parameters
    ----------
    sightings : sightings, at least one; the clearest come first in the sample used by criteria.
    offset : whether the readings include an unknown offset, so that the unloaded readings are unknown.

    Raises
    ------
    NumericsError
        If the method, which the message names, cannot be prepared, or if no single scale maps the readings to the
        model's.
    PluginError
        If it fails with any other exception.
    """
    clearest = {seen.change.tobytes(): seen.change for seen in sorted(sightings, key=lambda seen: -seen.score)}
    problem = replace(
        sheet.problem, nominal=sheet.problem.nominal or sheet.problem, sample=np.array(list(clearest.values()))
    )
    gain = np.ones(len(problem.reference))
    if getattr(reconstruction, "absolute", False) and not offset:
        problem, gain = _with_measured(name, problem, model, sightings)
    with _convert_errors(f"{name} cannot be used for this recording"):
        prepared, remarks = _prepare_reconstruction(reconstruction, name, problem)
    return EventImages(name, prepared, gain, bool(getattr(reconstruction, "sequences", False)), remarks)


def _prepare_reconstruction(
    reconstruction: Reconstruction, name: str, problem: ImagingProblem
) -> tuple[PreparedReconstruction, tuple[str, ...]]:
    """Prepare on the recording's own changes, or without them, with a note, if they do not determine a parameter."""
    try:
        return reconstruction.prepare(problem), ()
    except NumericsError as refused:
        try:
            prepared = reconstruction.prepare(replace(problem, sample=None))
        except NumericsError:
            raise refused from None
        remark = f"cannot choose the parameter of {name} from this recording: {refused.reason}"
        return prepared, (remark,)


def _with_measured(
    name: str, problem: ImagingProblem, model: UnitModel, sightings: Sequence[Sighting]
) -> tuple[ImagingProblem, Array]:
    """Add the readings before the first event, and the gain to their scale."""
    unloaded = min(sightings, key=lambda seen: seen.start_s).unloaded
    plain = plain_model(unloaded, problem)
    if plain is None:
        raise NumericsError(
            f"{name} cannot be used for this recording: it needs absolute unloaded readings, and a single scale does"
            " not map these to the model's (channels of unequal gain, another geometry, or no sheet)",
            remedy="name the sensor type of the recording, or use a difference reconstruction",
        )
    assert problem.sample is not None
    gain = plain.gain / model.gain
    return replace(problem, measured=unloaded * plain.gain, sample=problem.sample * gain), gain


@contextmanager
def _convert_errors(where: str) -> Iterator[None]:
    """Turn any exception of a plugin's method into one clear refusal."""
    try:
        with end_forked_copies():
            yield
    except CbsrError as error:
        raise NumericsError(f"{where}: {error.reason}", remedy=error.remedy or _REMEDY) from error
    except Exception as error:
        raise PluginError(f"{where}: {type(error).__name__}: {error}", remedy=_REMEDY) from error


def _check_images(images: object, shape: tuple[int, int]) -> Array:
    values = np.asarray(images, dtype=np.float64)
    if values.shape != shape:
        raise NumericsError(f"it returned images of shape {values.shape} instead of {shape}")
    if not np.isfinite(values).all():
        raise NumericsError("it returned an image with non-finite values")
    return values
