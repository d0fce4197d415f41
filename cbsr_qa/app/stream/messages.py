"""Messages of a stream of forces: each is one JSON object on one line, whose keys are the fields here."""

import json
from dataclasses import asdict, dataclass
from typing import Final, Literal

from cbsr_qa.calibration.runtime.estimator import Interval

#: Raised by one when a key is removed or changes its meaning. New keys and new types of messages do not raise it.
SCHEMA_VERSION: Final = 1


@dataclass(frozen=True, slots=True)
class HeaderMessage:
    """First message for every client, also for one that joins late: what the stream is of.

    Parameters
    ----------
    sequence : 0; counts the messages of the stream.
    calibration, calibration_digest : identity and SHA-256 of the calibration file.
    kind : ``run`` if a run at a station issued it, ``presses`` if it was learned from labelled presses;
        another word for another way to calibrate.
    force : whether frames have a force; a calibration from presses without forces has places alone.
    radius_mm : radius of the sheet, or of the disc of equal area [mm].
    axes : what x and y are.
    driver, source : driver of the instrument, and its own description; ``simulated`` if it measures nothing real.
    frame_period_s : time from one frame to the next.
    started : UTC.
    remarks : remarks on what is done to readings, and on what was not checked.
    """

    type: Literal["header"]
    sequence: int
    schema: Literal["cbsr-qa-force-stream"]
    schema_version: int
    serial: str
    sensor_type: str
    calibration: str
    calibration_digest: str
    kind: str
    force: bool
    unit_force: Literal["N"]
    unit_place: Literal["mm"]
    radius_mm: float
    axes: str
    driver: str
    source: str
    simulated: bool
    frame_period_s: float
    started: str
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FrameMessage:
    """Force and place in one frame.

    Parameters
    ----------
    sequence : number of the message; one more than that of the message before.
    frame : number of the frame, from 0.
    time : UTC, of the middle of the frame.
    monotonic_s : the same on the monotonic clock of the computer that sends (CLOCK_MONOTONIC).
    force_N, force_68_N, force_95_N : force, and intervals that hold it with that probability; null without one.
    x_mm, y_mm : place of the press; null if nothing presses.
    radius_68_mm, radius_95_mm : radii of circles about the place that hold it at least with that probability [mm].
    touch : whether something presses; null if the frame does not tell.
    flags : names of :class:`~cbsr_qa.calibration.force.inverse.Flag`, in lower case.
    settled_in_s : time until the force counts, 0 where it does; null where that is not known.
    missed : frame periods without a frame since the stream began.
    latency_ms : time from the end of the frame until this message was handed to those who send it [ms].
    """

    type: Literal["frame"]
    sequence: int
    serial: str
    frame: int
    time: str
    monotonic_s: float
    force_N: float | None
    force_68_N: Interval | None
    force_95_N: Interval | None
    x_mm: float | None
    y_mm: float | None
    radius_68_mm: float | None
    radius_95_mm: float | None
    touch: bool | None
    flags: tuple[str, ...]
    settled_in_s: float | None
    missed: int
    latency_ms: float


@dataclass(frozen=True, slots=True)
class InterruptedMessage:
    """The instrument failed, and is asked again: frames may follow. ``reason`` in words."""

    type: Literal["interrupted"]
    sequence: int
    serial: str
    reason: str


@dataclass(frozen=True, slots=True)
class AliveMessage:
    """Nothing was sent for a second, but the stream goes on. ``sequence`` is that of the last message."""

    type: Literal["alive"]
    sequence: int
    serial: str


@dataclass(frozen=True, slots=True)
class DroppedMessage:
    """The client was too slow: ``count`` messages before ``sequence`` were dropped, ``total`` since it joined."""

    type: Literal["dropped"]
    sequence: int
    serial: str
    count: int
    total: int


@dataclass(frozen=True, slots=True)
class EndMessage:
    """Last message.

    Parameters
    ----------
    why : ``stopped`` on request, ``over`` if a recording has been played to its end, ``failed`` if the instrument or
        the program failed.
    reason : reason in words.
    frames, missed : sent, and frame periods without a frame.
    exit_code : exit code of the program.
    """

    type: Literal["end"]
    sequence: int
    serial: str
    why: Literal["stopped", "over", "failed"]
    reason: str
    frames: int
    missed: int
    exit_code: int


StreamMessage = HeaderMessage | FrameMessage | AliveMessage | DroppedMessage | InterruptedMessage | EndMessage


def json_line(message: StreamMessage) -> bytes:
    """Return a message as one line of JSON. Raise ValueError if a number in it is not finite."""
    return json.dumps(asdict(message), separators=(",", ":"), allow_nan=False).encode() + b"\n"
