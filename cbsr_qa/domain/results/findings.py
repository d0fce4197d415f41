"""Findings in an unannotated recording: channels, noise, and presses as events."""

from dataclasses import dataclass
from typing import Final

from cbsr_qa.domain.goodness import Goodness
from cbsr_qa.domain.imaging import Image, ParameterChoice
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.readings.frames import Recording
from cbsr_qa.domain.sensor.sensor_type import SensorType

_AT_CENTRE: Final = 0.15  #: r/R within which an object has no direction worth a turn
_NO_TURN: Final = 0.05
_WHOLE_TURN: Final = 0.15


def place_in_words(electrode: float, r_over_R: float, electrodes: int) -> str:
    """Return a place for people: ``electrode 7.2, r/R 0.55``, or ``centre (r/R 0.07)``.

    Parameters
    ----------
    electrode : direction as a fractional 0-based electrode number.
    electrodes : number of electrodes; a direction just before the first is rounded to 0.0.
    """
    if r_over_R < _AT_CENTRE:
        return f"centre (r/R {r_over_R:.2f})"
    return f"electrode {round(electrode, 1) % electrodes:.1f}, r/R {r_over_R:.2f}"


class _OnDisc:
    """A place on a disc, ``x_over_R`` and ``y_over_R``, and its direction ``electrode``."""

    __slots__ = ()
    x_over_R: float
    y_over_R: float
    electrode: float
    electrodes: int

    @property
    def r_over_R(self) -> float:
        return float((self.x_over_R**2 + self.y_over_R**2) ** 0.5)

    @property
    def central(self) -> bool:
        """Whether it is too near the centre to have a direction."""
        return self.r_over_R < _AT_CENTRE

    @property
    def place(self) -> str:
        """The place in words, see :func:`place_in_words`."""
        return place_in_words(self.electrode, self.r_over_R, self.electrodes)


@dataclass(frozen=True, slots=True)
class NoiseStep:
    """A sudden change of a recording's noise or level.

    Parameters
    ----------
    what : ``"level"`` or ``"noise"``.
    before, after : level or rms noise on either side, in the recording's unit.
    """

    time_s: float
    what: str
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class NoiseReport:
    """Noise of the quiet part of a recording, estimated robustly.

    Parameters
    ----------
    rms : median over channels of the rms noise of one reading, in ``unit``; None where too few frames exist.
    unit : the recording's, ``"V"`` or ``"count"``.
    drift_per_min : median over channels of the slope, in ``unit`` per minute; None where time is unknown.
    steps : changes of level or noise; if any, ``rms`` is that of the longest quiet stretch.
    quiet_s : start and end of that stretch [s]; may be None.
    frames : number of its frames.
    outliers : share of all readings further than six times the noise from their channel's level in that stretch.
    """

    rms: float | None
    unit: str
    drift_per_min: float | None
    steps: tuple[NoiseStep, ...]
    quiet_s: tuple[float, float] | None
    frames: int
    outliers: float | None = None


@dataclass(frozen=True, slots=True)
class ChannelReport:
    """State of a recording's channels.

    Parameters
    ----------
    saturated, stuck : (drive, measure) index pairs at the converter's end, or that never change (any more).
    not_connected : whether nothing was connected at all.
    used : number of readings that were imaged.
    snr_db : median over used channels of level over noise; None without a noise estimate.
    reciprocity_error : rms |V_ij − V_ji| over rms |V| on used pairs, as recorded; None for one-row scans.
    reading_memory : share m of the previous reading estimated from reciprocity; None where not estimated.
    reciprocity_error_corrected : the same after the correction.
    memory_corrected : whether the correction was applied before imaging.
    suspect_electrodes : excluded because their readings changed together: a contact, not a load.
    """

    saturated: tuple[tuple[int, int], ...]
    stuck: tuple[tuple[int, int], ...]
    not_connected: bool
    used: int
    snr_db: float | None
    reciprocity_error: float | None
    reading_memory: float | None
    reciprocity_error_corrected: float | None
    memory_corrected: bool
    suspect_electrodes: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class ImagedPlace(_OnDisc):
    """Place and strength of an event in its image.

    Parameters
    ----------
    x_over_R, y_over_R : centre of mass of its region, in units of the sheet's radius.
    electrode : its direction as a fractional 0-based electrode number, of ``electrodes``.
    largest : relative conductance change of largest size in the region.
    area_share : share of the sheet where the image exceeds half of that.
    """

    x_over_R: float
    y_over_R: float
    electrode: float
    electrodes: int
    largest: float
    area_share: float


@dataclass(frozen=True, slots=True, eq=False)
class EventImaging:
    """Method by which the images of events were made.

    Parameters
    ----------
    reconstruction : the plugin, and the options it was given.
    choice : choice of its parameter; None if there was no event to image.
    elements : number of elements of an image; None likewise.
    """

    reconstruction: PluginChoice
    choice: ParameterChoice | None = None
    elements: int | None = None


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of a tracked object.

    Parameters
    ----------
    begins, ends : electrode (direction as a fractional number) and r/R of its first and last place.
    turns : round the centre, positive towards higher electrode numbers; undefined for a path through the centre.
    nearest_r_over_R : smallest distance from the centre.
    electrodes : number of electrodes.
    """

    begins: tuple[float, float]
    ends: tuple[float, float]
    turns: float
    nearest_r_over_R: float
    electrodes: int

    @property
    def words(self) -> str:
        """Describe the path: start, end and direction."""
        places = "from " + " to ".join(place_in_words(*place, self.electrodes) for place in (self.begins, self.ends))
        way = self._describe_way()
        return f"{places}, {way}" if way else places

    def _describe_way(self) -> str:
        if self.nearest_r_over_R < _AT_CENTRE:
            return "through the centre"
        sense = f"towards {'higher' if self.turns > 0 else 'lower'} electrode numbers"
        round_ = abs(self.turns)
        if round_ < _NO_TURN:
            return ""
        if abs(round_ - 1) <= _WHOLE_TURN:
            return f"once round, {sense}"
        return f"{round_:.1f} times round, {sense}" if round_ > 1 else sense


@dataclass(frozen=True, slots=True, eq=False)
class LoadEvent(_OnDisc):
    """One press (or object), detected without prior knowledge of place or time.

    Parameters
    ----------
    start_s, peak_s, end_s : start, peak and end on the recording's clock [s]; ``end_s`` is the last frame if it lasts
        to the end.
    x_over_R, y_over_R : place in units of the sheet's radius, x towards electrode 0's direction as drawn.
    electrode : its direction as a fractional 0-based electrode number, of ``electrodes``.
    sign : +1 if the place conducts more, −1 less.
    snr : detection statistic over its noise, dimensionless.
    x_mm, y_mm : place [mm]; only if a sensor type was named.
    force_N : peak force while it lasted; None where not recorded.
    track : (time_s, x_over_R, y_over_R) per frame of an object that moves; empty for a press.
    motion : motion of an object; None if it stays, and for a press.
    fate : beside others held at its peak, whether the image shows it ``"apart"``, ``"merged"`` with one of them, or
        it was ``"missed"``; empty where it was alone.
    imaged : its place in its image; None if the image shows nothing near it.
    goodness : goodness of the fit of loads on the modelled sheet.
    """

    start_s: float
    peak_s: float
    end_s: float
    x_over_R: float
    y_over_R: float
    electrode: float
    electrodes: int
    sign: int
    snr: float
    image: Image
    x_mm: float | None = None
    y_mm: float | None = None
    force_N: float | None = None
    track: tuple[tuple[float, float, float], ...] = ()
    motion: Motion | None = None
    fate: str = ""
    imaged: ImagedPlace | None = None
    goodness: Goodness | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RecordingResult:
    """A recording with all findings.

    Parameters
    ----------
    frame_rate_hz : None for still images.
    events_why : why there is no event ("nothing stands out of the noise", …), else empty.
    sensor_type : None if not stated.
    imaging : description of how the images were made; None if such a recording cannot be imaged.
    """

    recording: Recording
    frame_rate_hz: float | None
    channels: ChannelReport
    noise: NoiseReport
    events: tuple[LoadEvent, ...]
    events_why: str
    warnings: tuple[str, ...] = ()
    compute_s: tuple[tuple[str, float], ...] = ()
    sensor_type: SensorType | None = None
    imaging: EventImaging | None = None
