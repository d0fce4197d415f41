"""Forces of an instrument's frames as they are taken."""

from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from cbsr_qa.app.stream.messages import EndMessage, FrameMessage
from cbsr_qa.app.stream.source import FramesFrom
from cbsr_qa.app.stream.stream import StreamRequest, stream_messages
from cbsr_qa.domain.errors import BrokenError

__all__ = ["FrameMessage", "stream"]


def stream(
    calibration: str | Path,
    *,
    driver: str | None = None,
    options: Mapping[str, Any] | None = None,
    station: str | Path | None = None,
    reference: int | None = None,
    sensor_type: str | None = None,
    public_key: str | Path | None = None,
    certificate: str | Path | None = None,
    withdrawn: str | Path | None = None,
) -> Iterator[FrameMessage]:
    """Yield the force in every frame of an instrument, as ``cbsr-qa stream`` sends it with the same options.

    It ends with a recording that is played. The instrument is closed with the iterator.

    Parameters
    ----------
    driver, options : of an instrument that takes frames, as in its table of a station file.
    station : station file or name, in place of a driver.
    reference : number of first frames that are of the unloaded sheet.
    sensor_type : of a calibration from labelled presses, if it is not a shipped one.
    public_key, certificate, withdrawn : as :func:`~cbsr_qa.calibration.loading.load_calibration`.

    Raises
    ------
    CbsrError
        If it is refused, or the instrument fails.
    """
    source = FramesFrom(driver, options, None if station is None else str(station))
    key, seal, gone = (None if file is None else Path(file) for file in (public_key, certificate, withdrawn))
    request = StreamRequest(
        Path(calibration), source, reference, sensor_type, public_key=key, certificate=seal, withdrawn=gone
    )
    with closing(stream_messages(request)) as messages:
        for message in messages:
            if isinstance(message, FrameMessage):
                yield message
            elif isinstance(message, EndMessage) and message.why == "stopped":
                raise KeyboardInterrupt(message.reason)
            elif isinstance(message, EndMessage) and message.why == "failed":
                raise BrokenError(message.reason)
