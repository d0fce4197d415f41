"""Frames of counts out of the ERT board's bytes: the board is sent no commands, and it never stops."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Counts = NDArray[np.int64]

#: Boards of this firmware by their current pairs, which are as many as the voltages read for each: the authors', and
#: one of twice the size.
BOARDS: Final = (16, 32)
_RECORD: Final = 3  # a count, low byte first, and a carriage return
_RETURN: Final = 0x0D
_MARK: Final = ord("A")
#: What the mark and its carriage return are taken for, read late and read early.
_MARKS_AS_COUNTS: Final = (_MARK + 256 * _RETURN, _RETURN + 256 * _MARK)
#: Readings are noisy: two places fit so often only in a stream that does not change at all.
_MAX_ROUNDS: Final = 6
#: Characters of a number and its comma, and of the board's clock; a line of more for each number holds no row.
_MAX_NUMBER_LENGTH: Final = 24


def binary_frame_bytes(pairs: int) -> int:
    """Return the length of a binary frame: its records, then ``A`` and a carriage return."""
    return _RECORD * pairs * pairs + 2


@dataclass(frozen=True, slots=True)
class BoardFrame:
    """One whole frame as it was sent.

    Parameters
    ----------
    counts : (pairs, pairs) int64; rows and columns in the order of the stream.
    after_loss : bytes between the frame before and this one belonged to no whole frame.
    """

    counts: Counts
    after_loss: bool


class BoardStream(ABC):
    """Parses the board's bytes.

    Parameters
    ----------
    pairs : of the board: current pairs, and voltages read for each.
    """

    def __init__(self, pairs: int) -> None:
        self._pairs = pairs
        self.restart()

    @abstractmethod
    def feed(self, data: bytes) -> list[BoardFrame]:
        """Take what has come, and return the frames that are whole by now."""

    def restart(self) -> None:
        """Forget what has come: bytes were thrown away, and what comes next may begin anywhere in a frame."""
        self._buffer = b""
        self._has_frame = self._follows_loss = False

    def _spoil(self) -> None:
        """Note that bytes belong to no whole frame; those before the first frame cost none."""
        self._follows_loss = self._has_frame

    def _whole(self, counts: Counts) -> BoardFrame:
        frame = BoardFrame(counts, self._follows_loss)
        self._has_frame, self._follows_loss = True, False
        return frame


class BinaryStream(BoardStream):
    r"""Frames of 770 bytes with 16 pairs: 256 records of a count (uint16, low byte first) and ``\r``, then ``A\r``.

    A byte of a count can be ``\r`` or ``A`` too, so that frames are cut by length: one begins where all
    separators stand where they should. They also do so 3 k bytes beside a frame whose first or last k counts
    happen to hold the right bytes; the mark is then taken for a count. Where a count looks like the mark, as
    many frames are looked at as it takes until only one place is left, up to :data:`_MAX_ROUNDS`.

    Counts carry no checksum: a changed byte is noticed only where it stands between counts.
    """

    _locked = False

    def __init__(self, pairs: int) -> None:
        super().__init__(pairs)
        self._bytes = binary_frame_bytes(pairs)

    def feed(self, data: bytes) -> list[BoardFrame]:
        """Take what has come, and return the frames that are whole by now."""
        self._buffer += data
        frames: list[BoardFrame] = []
        while self._locked or self._synchronise():
            if len(self._buffer) < self._bytes:
                break
            if not self._fits(self._buffer, 0):
                self._locked = False
                continue
            frames.append(self._whole(self._counts(self._buffer)))
            self._buffer = self._buffer[self._bytes :]
        return frames

    def restart(self) -> None:
        super().restart()
        self._locked = False

    def _synchronise(self) -> bool:
        """Find the start of a frame, and drop bytes before it."""
        received = self._buffer
        start = next((k for k in range(len(received) - self._bytes + 1) if self._fits(received, k)), None)
        if start is None:
            self._drop(max(len(received) - self._bytes + 1, 0))
            return False
        if np.isin(self._counts(received, start), _MARKS_AS_COUNTS).any():
            undoubted = self._find_unique_start(start)
            if undoubted is None:
                return False
            start = undoubted
        self._drop(start)
        self._locked = True
        return True

    def _find_unique_start(self, start: int) -> int | None:
        """Return the only start within a round that keeps fitting; None if more bytes are needed."""
        candidates = list(range(start, start + self._bytes))
        for number in range(_MAX_ROUNDS):
            if len(self._buffer) < start + (number + 2) * self._bytes - 1:
                return None
            candidates = [k for k in candidates if self._fits(self._buffer, k + number * self._bytes)]
            if len(candidates) < 2:
                break
        return candidates[0] if candidates else start

    def _drop(self, count: int) -> None:
        if count:
            self._spoil()
            self._buffer = self._buffer[count:]

    def _fits(self, data: bytes, start: int) -> bool:
        end = start + self._bytes
        if data[end - 2] != _MARK or data[end - 1] != _RETURN:
            return False
        return data[start + _RECORD - 1 : end - 2 : _RECORD].count(_RETURN) == self._pairs**2

    def _counts(self, data: bytes, start: int = 0) -> Counts:
        records = np.frombuffer(data, np.uint8, self._bytes - 2, start).reshape(-1, _RECORD)
        counts = records[:, 0].astype(np.int64) + 256 * records[:, 1].astype(np.int64)
        return counts.reshape(self._pairs, self._pairs)


class TextStream(BoardStream):
    """Frames of text: a line ``A``, then a row of counts for each drive pair, each count with a comma behind it.

    A frame is whole when the next ``A`` follows its last row: a row that came twice would make one too early.

    The board's clock [ms] may stand in front of a row. Logs that the board prints between rows are left out; a row
    that is cut, joined with another or holds anything but counts spoils its frame.
    """

    def __init__(self, pairs: int, lowest: int, highest: int) -> None:
        super().__init__(pairs)
        self._range = (lowest, highest)

    def feed(self, data: bytes) -> list[BoardFrame]:
        """Take what has come, and return the frames that are whole by now."""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        if len(self._buffer) > _MAX_NUMBER_LENGTH * (self._pairs + 1):
            self._spoil_frame()
            self._buffer = b""
        return [frame for line in lines if (frame := self._line(line)) is not None]

    def restart(self) -> None:
        super().restart()
        self._rows: list[list[int]] | None = None

    def _line(self, line: bytes) -> BoardFrame | None:
        text = line.decode("ascii", "replace").strip()
        if text == "A":
            return self._finish_frame()
        if self._rows is None:
            return None
        # Whether the line was meant as a row of counts, valid or not, rather than a log.
        fields = text.rstrip(",").split(",")
        count_fields = sum(field.strip().lstrip("-").isdigit() for field in fields)
        if len(fields) > 2 and count_fields > len(fields) / 2:
            row = self._row(text)
            if row is None or len(self._rows) == self._pairs:
                self._spoil_frame()
            else:
                self._rows.append(row)
        return None

    def _finish_frame(self) -> BoardFrame | None:
        frame = None
        if self._rows is not None and len(self._rows) == self._pairs:
            frame = self._whole(np.array(self._rows, dtype=np.int64))
        elif self._rows:
            self._spoil()
        self._rows = []
        return frame

    def _row(self, text: str) -> list[int] | None:
        """Return a row's counts, without the board's clock; None if one is missing or invalid."""
        if not text.endswith(","):
            return None
        try:
            numbers = [int(field) for field in text[:-1].split(",")]
        except ValueError:
            return None
        counts = numbers[-self._pairs :]
        low, high = self._range
        right = len(numbers) in (self._pairs, self._pairs + 1) and all(low <= count <= high for count in counts)
        return counts if right else None

    def _spoil_frame(self) -> None:
        self._spoil()
        self._rows = None


def stream_order(pairs: int, order: str, first: int) -> NDArray[np.int64]:
    """Index into the flattened canonical frame of each reading, in the order of the stream, (pairs²,) int64.

    Parameters
    ----------
    pairs : of the board.
    order : ``"measure"`` (the voltage pair steps faster) or ``"drive"``.
    first : how many readings later in that order the stream begins.
    """
    canonical = np.arange(pairs * pairs, dtype=np.int64).reshape(pairs, pairs)
    scanned = canonical if order == "measure" else canonical.T
    return np.roll(scanned.ravel(), -first)
