"""A calibration in use: frames in; force, place, their errors and flags out. Numpy alone.

An :class:`Estimator` is made by :mod:`cbsr_qa.calibration.loading`. Code that applies calibrations knows this
Protocol alone, so another way to learn a calibration is another class that implements it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Protocol

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.calibration.force.inverse import NO_FORCE, Flag
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.readings.frames import UNUSABLE, FrameBlock, Recording
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import SensorType

#: Lowest and highest of an interval.
Interval = tuple[float, float]
#: Frames with one of these flags are not of one touch as the calibration knows it.
_UNLIKE: Final = int(
    Flag.NOT_DETECTED | Flag.MORE_THAN_ONE | Flag.UNREADABLE | Flag.OTHER_SENSOR | Flag.NOT_AS_MODELLED
)


class Ability(StrEnum):
    """Something that a calibration may be unable to do; then :attr:`Estimator.lacks` says why."""

    FORCE = "force"  #: the force of a touch
    FORCE_68, FORCE_95 = "force_68", "force_95"  #: the interval that holds the force with that probability
    DEPTH = "depth"  #: the depth of a touch
    REGION = "region"  #: a covariance of the place, which shapes its regions
    REGION_95 = "region_95"  #: the region that holds the place with 95 %
    STDERR = "stderr"  #: standard errors of force and place
    DETECTABILITY = "detectability"  #: the signal of a touch over the noise
    SETTLING = "settling"  #: when the force of a frame counts
    GIVEN_PLACE = "given_place"  #: forces at a place that is given
    SERIAL = "serial"  #: the serial number of its sensor
    FRAMES = "frames"  #: frames of the sensor type, whose pattern it states
    READINGS = "readings"  #: readings of named pairs, changes instead of frames, unloaded frames of another file


@dataclass(frozen=True, slots=True)
class CalibrationIdentity:
    """Identity of a calibration and of its sensor.

    Parameters
    ----------
    serial : serial number of the sensor; empty where :attr:`Ability.SERIAL` is lacking.
    calibration, calibration_digest : identity and SHA-256 of the calibration file.
    kind : source that it was learned from: ``run``, ``presses``, or a word of another implementation.
    sensor_type, electrodes : name of the sensor's type, and its number of electrodes.
    axes : meaning of x and y.
    """

    serial: str
    calibration: str
    calibration_digest: str
    kind: str
    sensor_type: str
    electrodes: int
    axes: str


@dataclass(frozen=True, slots=True)
class Regions:
    """Regions of places: all offsets d with dᵀΣ⁻¹d at most ``q68`` or ``q95``, Σ the covariance of the place.

    ``q95`` is None where :attr:`Ability.REGION_95` is lacking.
    """

    q68: float
    q95: float | None


@dataclass(frozen=True, slots=True)
class UnloadedFrames:
    """Unloaded frames to compare with; at most one kind is given. The default is the calibration's own frame.

    Parameters
    ----------
    first : number of first frames that are of the unloaded sheet.
    rest : frames of the unloaded sheet from elsewhere.
    differences : True if the readings are changes already, in which faults cannot be found.
    """

    first: int | None = None
    rest: FrameBlock | None = None
    differences: bool = False


#: Frames are compared with the calibration's own unloaded frame.
AS_CALIBRATED: Final = UnloadedFrames()


@dataclass(frozen=True, slots=True, eq=False)
class TouchValues:
    """A quantity of the touches in n frames.

    Parameters
    ----------
    values : (n,) force [N] or depth [mm]; NaN in frames that do not tell it.
    within_68, within_95 : (n, 2) lowest and highest of the interval that holds it with that probability: NaN in
        frames without one, None where the calibration lacks that ability.
    stderr : (n,) standard error of the value.
    shared_stderr : (n,) part of it that all values of the calibration share, which does not average out.
    """

    values: Array
    within_68: Array | None
    within_95: Array | None
    stderr: Array | None = None
    shared_stderr: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ModelledTouches:
    """Places of the touches by a modelled sheet alone.

    Parameters
    ----------
    place_mm, covariance_mm2 : (n, 2) places and their (n, 2, 2) covariances; NaN in frames that do not tell it.
    explained : (n,) share of the readings' squares that a touch there explains.
    in_model : (n,) mask of frames in which that is enough for the place to be relied on.
    """

    place_mm: Array
    covariance_mm2: Array
    explained: Array
    in_model: Mask


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Touches:
    """One touch in each of n frames: None for what the calibration cannot tell, NaN for what a frame does not.

    Parameters
    ----------
    touch : (n,) mask of frames in which something presses; it means nothing where not :attr:`readable`.
    place_mm : (n, 2) place of the touch, in the axes of :attr:`CalibrationIdentity.axes`.
    place_stderr_mm : (n,) standard error of the place, root mean square over two axes.
    radius_68_mm, radius_95_mm : (n,) radii of circles about the place that hold it at least with that probability.
    covariance_mm2 : (n, 2, 2) covariances of the place; see :class:`Regions`.
    force, depth : force [N] and depth [mm] of the touch.
    flags : (n,) values of :class:`~cbsr_qa.calibration.force.inverse.Flag`.
    detectability : (n,) signal of the touch over the noise of the readings.
    settled_in_s : (n,) time until the force counts, 0 where it does; NaN where that is not known.
    modelled : places by a modelled sheet alone.
    """

    touch: Mask
    flags: Indices
    place_mm: Array
    place_stderr_mm: Array | None
    radius_68_mm: Array
    radius_95_mm: Array | None
    covariance_mm2: Array | None = None
    force: TouchValues | None = None
    depth: TouchValues | None = None
    detectability: Array | None = None
    settled_in_s: Array | None = None
    modelled: ModelledTouches | None = None

    def __len__(self) -> int:
        return len(self.flags)

    def __repr__(self) -> str:
        counts = {flag.name: int(np.count_nonzero(self.flags & flag)) for flag in Flag}
        flagged = "".join(f", {name} in {count}" for name, count in counts.items() if count)
        return f"<Touches in {int(np.count_nonzero(self.touch & self.readable))} of {len(self)} frames{flagged}>"

    @property
    def readable(self) -> Mask:
        """Mask (n,) of frames that tell whether something presses."""
        readable: Mask = (self.flags & NO_FORCE) == 0
        return readable

    @property
    def in_model(self) -> Mask:
        """Mask (n,) of frames of one touch like those of the calibration."""
        model_mask: Mask = (self.flags & _UNLIKE) == 0
        return model_mask


class FrameSequence(Protocol):
    """Frames of one instrument or recording, compared with the same unloaded sheet, in their order.

    Attributes
    ----------
    remarks : sentences that say what is done to readings, and what was not checked.
    """

    @property
    def remarks(self) -> tuple[str, ...]: ...

    def estimate(self, frames: FrameBlock) -> Touches:
        """Estimate the touches of the next frames."""
        ...


class Estimator(Protocol):
    """A calibration in use.

    Attributes
    ----------
    identity : identity of the calibration and of its sensor.
    lacks : abilities that it lacks, each with the reason as the end of a sentence that begins with the calibration.
    sensor_type : type of the sensor of its frames; None if it keeps only the name and the pattern.
    pattern : drive pattern of its frames; None where :attr:`Ability.FRAMES` is lacking.
    head : head that it was learned with; None if that is not known.
    regions : regions of its places; None where :attr:`Ability.REGION` is lacking.
    force_error : what errors of its forces include, e.g. ``scatter only; load cell not stated``.
    """

    @property
    def identity(self) -> CalibrationIdentity: ...
    @property
    def lacks(self) -> Mapping[Ability, str]: ...
    @property
    def sensor_type(self) -> SensorType | None: ...
    @property
    def pattern(self) -> DrivePattern | None: ...
    @property
    def head(self) -> Indenter | None: ...
    @property
    def regions(self) -> Regions | None: ...
    @property
    def force_error(self) -> str: ...

    def estimate(self, frames: ArrayLike) -> Touches:
        """Estimate the touch in each frame by itself, against the calibration's own unloaded frame.

        Parameters
        ----------
        frames : (n, drives, measures) or (drives, measures), in the unit and at the current of the calibration; a
            reading that is NaN or masked is missing.

        Raises
        ------
        CalibrationError
            If the frames do not have the sensor's shape, or the calibration cannot be applied to whole frames.
        NumericsError
            If they are not real numbers.
        """
        ...

    def prepare(self) -> None:
        """Compute what is computed only once, so that no frame waits for it.

        CalibrationError if it cannot be applied to frames.
        """
        ...

    def check_recording(self, recording: Recording) -> None:
        """Refuse a recording whose frames are not those of the sensor. RecordingError says what was found."""
        ...

    def follow(
        self,
        name: str,
        first: FrameBlock,
        unloaded: UnloadedFrames = AS_CALIBRATED,
        *,
        timed: bool = True,
        place_mm: ArrayLike | None = None,
    ) -> FrameSequence:
        """Begin to follow the frames of an instrument or a recording.

        Parameters
        ----------
        name : name of the frames in messages.
        first : frames of which unit, current and unloaded sheet are known; they are not estimated.
        unloaded : unloaded frames that frames are compared with.
        timed : True if the times of frames rise; False to estimate each frame by itself.
        place_mm : (2,) place of the touch, where :attr:`Ability.GIVEN_PLACE` is not lacking; None to estimate it.

        Raises
        ------
        RecordingError
            If the frames cannot be brought to the calibration's scale.
        CalibrationError
            If the calibration lacks what is asked for, or an unloaded frame to compare with.
        """
        ...

    def estimate_readings(
        self, pairs: Indices, readings: Array, *, relative: bool = False, differences: bool = False
    ) -> Touches:
        """Estimate the touches in rows of readings, where :attr:`Ability.READINGS` is not lacking.

        Parameters
        ----------
        pairs : (k, 4) source, sink, plus and minus of the readings, each once, in any order and polarity.
        readings : (n, k) readings in the unit of the calibration; NaN where one is missing.
        relative : True if the unloaded frame was subtracted from the readings.
        differences : True if the readings are changes in which faults cannot be found.

        Raises
        ------
        CalibrationError
            If a calibrated pair is missing, the calibration holds no unloaded frame to compare whole ones with, or
            cannot be applied to readings of named pairs.
        """
        ...


def require_ability(estimator: Estimator, ability: Ability, remedy: str = "") -> None:
    """Raise CalibrationError with the reason, and a remedy, if a calibration lacks an ability."""
    if ability in estimator.lacks:
        raise CalibrationError(f"the calibration {estimator.lacks[ability]}", remedy=remedy)


def read_value(quantity: TouchValues | None, frame: int) -> tuple[float | None, Interval | None, Interval | None]:
    """Return what one frame tells of a quantity, else None: its value, and the intervals of 68 and 95 %."""
    if quantity is None or not np.isfinite(quantity.values[frame]):
        return None, None, None
    intervals = (
        None if interval is None else interval[frame].tolist()
        for interval in (quantity.within_68, quantity.within_95)
    )
    inner, outer = (
        None if interval is None or not np.isfinite(interval).all() else (interval[0], interval[1])
        for interval in intervals
    )
    return float(quantity.values[frame]), inner, outer


def mask_unusable(frames: FrameBlock) -> Array:
    """Return readings (n, drives, measures) as they are, NaN where they say nothing of the sheet."""
    return np.where((frames.flags & UNUSABLE) != 0, np.nan, frames.voltages)
