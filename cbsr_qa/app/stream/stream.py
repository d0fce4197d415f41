"""Frames in, newtons out: the loop of a stream, and the same as an iterator for Python."""

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final, Literal

from cbsr_qa.app.stream.forces import Estimate, list_estimates, prepare_estimator
from cbsr_qa.app.stream.messages import (
    SCHEMA_VERSION,
    EndMessage,
    FrameMessage,
    HeaderMessage,
    InterruptedMessage,
    StreamMessage,
)
from cbsr_qa.app.stream.source import FramesFrom, OpenedSource, open_source
from cbsr_qa.calibration.runtime.estimator import Ability, Estimator, UnloadedFrames
from cbsr_qa.domain.errors import CbsrError, InstrumentError, NoMoreFramesError, RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.readings.frames import FrameBlock, join_frames
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.plugin.discovery import Plugins, discover

#: Pauses between attempts of an instrument that says it may be asked again [s]: doubled, up to the longest.
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 5.0
#: Exit code of a stream that its instrument ended.
_FAILED: Final = InstrumentError.exit_code

#: Context that is entered while the stream waits for a frame: it decides what may interrupt the wait.
Waiting = Callable[[], AbstractContextManager[Any]]


@dataclass(frozen=True, slots=True)
class StreamRequest:
    """A stream; see the options of ``cbsr-qa stream``.

    Parameters
    ----------
    reference : number of first frames that are of the unloaded sheet; None to use the calibration's.
    sensor_type : sensor type of a calibration from presses, if its name is not that of a shipped one.
    give_up_s : longest time that an instrument that failed may take until it delivers frames again [s].
    public_key, certificate, withdrawn : as :func:`~cbsr_qa.calibration.loading.load_calibration`.
    """

    calibration: Path
    frames: FramesFrom
    reference: int | None = None
    sensor_type: str | None = None
    give_up_s: float = 30.0
    public_key: Path | None = None
    certificate: Path | None = None
    withdrawn: Path | None = None


def stream_messages(
    request: StreamRequest,
    *,
    plugins: Plugins | None = None,
    tell: Callable[[str], None] = lambda words: None,
    waiting: Waiting = nullcontext,
) -> Generator[StreamMessage, None, None]:
    """Yield the header, then a message for every frame, until a recording is over or the instrument fails.

    The last message is the end's, with its reason and exit code, also where a signal stops it. The instrument is
    closed with the iterator.

    Parameters
    ----------
    tell : called with what is waited for, and what could not be made safe or closed.
    waiting : entered while the stream waits for a frame.

    Raises
    ------
    CbsrError
        Before the header, if the stream is refused or the instrument does not answer.
    """
    estimator, sensor_type = prepare_estimator(
        request.calibration, request.sensor_type, request.public_key, request.certificate, request.withdrawn
    )
    plugins = plugins or discover()
    with open_source(request.frames, plugins, sensor_type, estimator.head, tell) as source:
        tell(f"waiting for a frame of {source.spec.driver}, one every {source.instrument.frame_period_s:.3g} s")
        stream = _Stream(request, source, estimator, sensor_type, waiting)
        yield stream.begin()
        yield from stream.messages()


class _Stream:
    def __init__(
        self,
        request: StreamRequest,
        source: OpenedSource,
        estimator: Estimator,
        sensor_type: SensorType,
        waiting: Waiting,
    ) -> None:
        self._request, self._source, self._waiting = request, source, waiting
        self._estimator, self._sensor_type = estimator, sensor_type
        self._serial = estimator.identity.serial
        self._sequence = self._frames = self._missed = 0
        self._before_s: float | None = None
        self._taken: list[_Taken] = []

    def begin(self) -> HeaderMessage:
        """Take the first frames, of which the scale is found, and return the header."""
        count = 1 if self._request.reference is None else self._request.reference
        source = self._source
        try:
            with self._waiting():
                while len(self._taken) < count:
                    self._taken.append(_Taken.take(source))
        except NoMoreFramesError as error:
            raise RefusedError(
                f"{source.spec.driver} has {len(self._taken)} frames; {count} are needed before the stream begins",
                remedy="give a smaller --reference, or a longer recording",
            ) from error
        first_frames = join_frames([batch.block for batch in self._taken])
        self._sequence_of_frames = self._estimator.follow(
            source.spec.driver, first_frames, UnloadedFrames(self._request.reference)
        )
        return fill_from_object(
            HeaderMessage,
            self._estimator.identity,
            type="header",
            sequence=0,
            schema="cbsr-qa-force-stream",
            schema_version=SCHEMA_VERSION,
            sensor_type=self._sensor_type.name,
            force=Ability.FORCE not in self._estimator.lacks,
            unit_force="N",
            unit_place="mm",
            radius_mm=self._sensor_type.radius_mm,
            driver=source.spec.driver,
            source=source.identity.model,
            simulated=source.identity.simulated,
            frame_period_s=float(source.instrument.frame_period_s),
            started=datetime.now(UTC).isoformat(),
            remarks=self._sequence_of_frames.remarks,
        )

    def messages(self) -> Iterator[StreamMessage]:
        """Yield messages up to the end."""
        pause_s, until_s = _FIRST_PAUSE_S, None
        while True:
            try:
                yield from self._frame_messages()
                pause_s, until_s = _FIRST_PAUSE_S, None
            except NoMoreFramesError:
                yield self._end("over", f"{self._source.spec.driver} has no more frames", 0)
                return
            except InstrumentError as error:
                until_s = until_s or time.monotonic() + self._request.give_up_s
                if not error.retryable or time.monotonic() + pause_s > until_s:
                    yield self._end("failed", str(error), _FAILED)
                    return
                yield InterruptedMessage("interrupted", self._number(), self._serial, error.reason)
                with self._waiting():
                    time.sleep(pause_s)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
            except CbsrError as error:
                yield self._end("failed", str(error), error.exit_code)
                return
            except KeyboardInterrupt as stop:
                yield self._end("stopped", str(stop) or "stopped from the keyboard", 0)
                return

    def _frame_messages(self) -> Iterator[FrameMessage]:
        if not self._taken:
            with self._waiting():
                self._taken = [_Taken.take(self._source)]
        batch, *self._taken = self._taken
        for estimate in list_estimates(self._sequence_of_frames.estimate(batch.block)):
            yield self._message(batch, estimate)

    def _message(self, taken: "_Taken", estimate: Estimate) -> FrameMessage:
        period_s = float(self._source.instrument.frame_period_s)
        if self._before_s is not None:
            self._missed += max(round((taken.time_s - self._before_s) / period_s) - 1, 0)
        self._before_s, self._frames = taken.time_s, self._frames + 1
        return fill_from_object(
            FrameMessage,
            estimate,
            type="frame",
            sequence=self._number(),
            serial=self._serial,
            frame=self._frames - 1,
            time=taken.wall.isoformat(timespec="microseconds"),
            monotonic_s=round(taken.monotonic_s, 6),
            missed=self._missed,
            latency_ms=round(1e3 * (time.monotonic() - taken.ended_s), 3),
        )

    def _end(self, why: Literal["stopped", "over", "failed"], reason: str, exit_code: int) -> EndMessage:
        counts = (self._frames, self._missed, exit_code)
        return EndMessage("end", self._number(), self._serial, why, reason, *counts)

    def _number(self) -> int:
        self._sequence += 1
        return self._sequence


@dataclass(frozen=True, slots=True, eq=False)
class _Taken:
    """A frame with its times.

    Parameters
    ----------
    time_s : middle of the frame on the station's clock [s].
    wall, monotonic_s : middle of the frame on the computer's clocks.
    ended_s : end of the frame on the monotonic clock [s].
    """

    block: FrameBlock
    time_s: float
    wall: datetime
    monotonic_s: float
    ended_s: float

    @classmethod
    def take(cls, source: OpenedSource) -> "_Taken":
        """Take the next frame."""
        block = source.frame()
        time_s, half_s = float(block.time_s[-1]), float(source.instrument.frame_period_s) / 2
        ago_s, now_s, wall = source.clock.now() - time_s, time.monotonic(), datetime.now(UTC)
        # A period that was estimated may end a little after the frame.
        ended_s = now_s - max(ago_s - half_s, 0.0)
        return cls(block, time_s, wall - timedelta(seconds=ago_s), now_s - ago_s, ended_s)
