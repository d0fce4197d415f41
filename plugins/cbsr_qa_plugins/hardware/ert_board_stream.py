"""The authors' ERT board, and others with its streaming firmware: frames arrive unrequested."""

import logging
import math
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from cbsr_qa.plugin import FrameBlock, InstrumentError, InstrumentIdentity, SerialLink, StationContext, driver
from cbsr_qa_plugins.hardware._board_settings import BoardOptions, count_pairs
from cbsr_qa_plugins.hardware._board_stream import (
    BinaryStream,
    BoardFrame,
    BoardStream,
    TextStream,
    binary_frame_bytes,
)
from cbsr_qa_plugins.hardware._driver import DriverBase, close_on_error

_DRIVER: Final = "ert-board-stream"
#: Between two calls nothing on the bench moves within this time: a frame that spans them counts [s].
_GOES_ON_S: Final = 0.05
#: A row is waited for a little longer than it takes, so that each waiting finds one.
_WAITED_ROWS: Final = 1.05
#: How long bytes that were sent may be on their way through the computer [s, real time].
_ON_ITS_WAY_S: Final = 0.2
#: A board without a whole frame for so many periods and this much time counts as silent.
_SILENT_PERIODS, _SILENT_S = 3.0, 0.5
#: The table's frame period is believed within this share.
_PERIOD_SHARE: Final = 0.2
#: More than the line can send while it is waited for once: it was there before.
_BACKLOG_BYTES: Final = 3500
_BACKLOG_S: Final = 0.01

_log: Final = logging.getLogger(__name__)


@driver(_DRIVER, BoardOptions)
def open_board(context: StationContext, options: BoardOptions) -> "ErtBoardStream":
    """Open the port of the authors' ERT board, and check that frames arrive as the options state.

    Options of its table
    --------------------
    address : serial port.
    frame_period_s : time from one frame to the next.
    format : format of the frames.
    baud : baud rate; 1 400 000 by default for binary frames.
    signed : counts of −32 768 to 32 767 instead of 0 to 65 535.
    range_counts : ends of the converter's range, if they differ from those.
    zero_counts : the count of 0 V, which is subtracted.
    order : ``"measure"`` if the voltage pair steps faster, or ``"drive"``.
    first_reading : where in that order a frame begins.
    current_mA : drive current, if known.
    memory_share : share of the previous reading that each reading keeps, as
        :func:`cbsr_qa.domain.readings.carry_over.estimate_carry_over` finds it from
        reciprocity. The driver removes it. A saturated reading counts as the end of the range; the first reading of a
        call is not corrected.

    Raises
    ------
    ConfigError
        If an option is unknown, missing or out of range, the line is too slow for the frames, or the sensor type is
        none of 16 × 16 or 32 × 32 readings.
    InstrumentError
        If the port cannot be opened, or what comes from it are no frames of this format and period.
    """
    return ErtBoardStream(context, options)


class ErtBoardStream(DriverBase):
    """Takes frames out of a stream that never stops.

    A frame counts if it began after it was asked for, or where the frame before it was asked for: what the board sent
    in between is thrown away. Its time is that of its last byte, less half a period. The board is sent no commands:
    it cannot be switched off, and its drive current flows while it has power.
    """

    def __init__(self, context: StationContext, options: BoardOptions) -> None:
        super().__init__(context, _DRIVER, options.address)
        self._pairs = count_pairs(context, _DRIVER, options)
        self._options, self._period_s = options, options.frame_period_s
        self._text = options.format == "ascii"
        self._stream: BoardStream = (
            TextStream(self._pairs, *options.limits) if self._text else BinaryStream(self._pairs)
        )
        self._ready: deque[tuple[float, BoardFrame]] = deque()
        self._read_s = -math.inf
        self._received_bytes = self._waits = 0
        self._down = False
        #: Frames lost within calls, and between calls that follow at once.
        self.frames_lost = 0
        assert options.speed is not None
        self._link = SerialLink(self._role, options.address, baud=options.speed)
        with close_on_error(self._link):
            self._check_stream()

    # --- instrument ---

    def identity(self) -> InstrumentIdentity:
        """Return the identity in the table: a board without commands has no query."""
        model = f"ERT board, {self._options.format} stream of {self._period_s:g} s a frame"
        if self._options.memory_share:
            model += f", reading memory of {self._options.memory_share:g} taken out"
        return self._build_identity(model)

    def alive(self) -> None:
        """Return as soon as the board has sent anything; what it sent is thrown away.

        InstrumentError if nothing comes for the time of some frames, or the link is down (retryable).
        """
        with self._recover_link():
            self._drain()
            asked_s, self._received_bytes = self._clock.now(), 0
            while not self._received_bytes:
                self._check_patience(asked_s)
                self._receive()

    def safe_state(self) -> None:
        """Do nothing: the board takes no commands, so that its current cannot be switched off."""

    def close(self) -> None:
        self._link.close()

    # --- frame source ---

    @property
    def frame_period_s(self) -> float:
        """Time of one frame, as the table says [s]."""
        return self._period_s

    def acquire(self, count: int) -> FrameBlock:
        """Take consecutive frames, all begun after this call.

        InstrumentError if no frame arrives in time or the link is down (retryable: the port is opened again).
        """
        self._check_count(count, retryable=True)
        with self._recover_link():
            since_s = self._earliest_start()
            frames = [self._read_frame(since_s) for _ in range(count)]
        return self._options.block([end_s for end_s, _ in frames], [frame.counts for _, frame in frames])

    def _earliest_start(self) -> float:
        """Return the earliest allowed start of a frame; discard earlier ones."""
        now_s = self._clock.now()
        slack_s = _WAITED_ROWS * self._row_s
        if now_s - self._read_s <= _GOES_ON_S:
            return now_s - _GOES_ON_S - slack_s
        self._drain()
        return now_s - slack_s

    def _read_frame(self, since_s: float) -> tuple[float, BoardFrame]:
        """Return the next frame that began after a time, with the time of its end."""
        asked_s, self._received_bytes = self._clock.now(), 0
        while True:
            while self._ready:
                end_s, frame = self._ready.popleft()
                if end_s - self._period_s >= since_s:
                    self._count_lost(end_s, frame)
                    return end_s, frame
            self._check_patience(asked_s)
            self._receive()

    def _count_lost(self, end_s: float, frame: BoardFrame) -> None:
        missing = round((end_s - self._read_s) / self._period_s) - 1 if math.isfinite(self._read_s) else 0
        lost = max(missing, int(frame.after_loss))
        if lost:
            self.frames_lost += lost
            _log.warning("%s at %s: %d frames were lost before one at %.3f s", self._role, self._address, lost, end_s)
        self._read_s = end_s

    def _receive(self) -> None:
        """Wait for about a row, and parse what arrived."""
        data = self._link.read_available()
        if not data:
            # One that has sent nothing for some rows is not looked after row by row.
            self._clock.sleep((1 + self._waits) * _WAITED_ROWS * self._row_s)
            data = self._read_pending()
        self._waits = 0 if data else self._waits + 1
        self._received_bytes += len(data)
        frames = self._stream.feed(data)
        now_s = self._clock.now()
        self._ready.extend(
            (now_s - (len(frames) - 1 - number) * self._period_s, frame) for number, frame in enumerate(frames)
        )

    def _read_pending(self) -> bytes:
        """Return pending input, after a short wait for more."""
        try:
            first = self._link.read(1, timeout_s=_ON_ITS_WAY_S)
        except InstrumentError as error:
            if not error.retryable:
                raise
            return b""
        return first + self._link.read_available()

    def _drain(self) -> None:
        """Discard all earlier data, including what the computer still buffers."""
        self._ready.clear()
        self._stream.restart()
        self._read_s = -math.inf
        try:
            while True:
                self._link.read(_BACKLOG_BYTES, timeout_s=_BACKLOG_S)
        except InstrumentError as error:
            if not error.retryable:
                raise
        self._link.flush_input()

    # --- the port ---

    @property
    def _row_s(self) -> float:
        return self._period_s / self._pairs

    def _check_stream(self) -> None:
        """Check that frames arrive at the stated rate."""
        self._drain()
        _, first = self._read_frame(-math.inf), self._clock.now()
        self._read_frame(-math.inf)
        found_s = self._clock.now() - first
        if abs(found_s - self._period_s) > _PERIOD_SHARE * self._period_s:
            raise self._error(
                f"a frame came after {found_s:.3g} s; frame_period_s is {self._period_s:g}",
                "correct frame_period_s in its table: the dry run and the times of frames count with it",
                retryable=True,
            )
        self._read_s = -math.inf

    @contextmanager
    def _recover_link(self) -> Iterator[None]:
        """Reopen a lost port; mark failures as retryable with a new stream."""
        try:
            if self._down:
                self._link.reopen()
                self._down = False
                self._drain()
            yield
        except InstrumentError as error:
            self._read_s = -math.inf
            if error.retryable:
                raise
            self._down = True
            raise self._restate_error(error, retryable=True) from error

    def _check_patience(self, asked_s: float) -> None:
        """Raise if no frame arrived for too long."""
        after_s = self._clock.now() - asked_s
        if after_s <= _SILENT_PERIODS * self._period_s + _SILENT_S:
            return
        received = f"{self._received_bytes} bytes, but no whole frame," if self._received_bytes else "nothing"
        text = f"A and {self._pairs} lines of {self._pairs} counts"
        expected = text if self._text else f"frames of {binary_frame_bytes(self._pairs)} bytes"
        raise self._error(
            f"sent {received} for {after_s:.3g} s; expected are {expected} every {self._period_s:g} s",
            "check address, baud and format, and that the board has power",
            retryable=True,
        )
