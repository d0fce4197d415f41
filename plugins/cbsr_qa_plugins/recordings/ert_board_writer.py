"""Simulated scenes as the ERT board's recorder with a load cell writes them.

Of the recorder's variants this one has the load cell and, in its rows, the board's clock; the variant that states the
drive current has neither.
"""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Final, TextIO

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import Dump, ReadingFlag, Recording, RefusedError, SampleBlock, Transcript, adjacent_pattern
from cbsr_qa_plugins.hardware._board_stream import BOARDS
from cbsr_qa_plugins.recordings import lab_files
from cbsr_qa_plugins.recordings.ert_board_clock import NEWTON_PER_GRAM
from cbsr_qa_plugins.recordings.ert_board_rows import LAST_BOARD_MS

NAME: Final = "ert-board-csv"
TITLES: Final = "time_pc [s],Mass [g],time_mcu[ms],data [mV]:"
#: Largest usual magnitude of a used reading in counts, with its headroom: below the end of 16 bits.
MOST_COUNTS: Final = 32_000
#: The end of 16 bits: driven pairs are cut there, as in the lab's recordings.
END_COUNTS: Final = 32_767
_HEADROOM: Final = 1.5  # for readings under loads; what a fault makes larger yet is cut
#: What the board's clock says when the computer's begins: the board was switched on first.
FIRST_BOARD_MS: Final = 1000

#: The log of ESP-IDF's task watchdog, with its blank lines; the addresses are invented.
_DUMP: Final = (
    "\x1b[0;31mE ({ms}) task_wdt: Task watchdog got triggered. The following tasks did not reset the watchdog "
    "in time:\x1b[0m",
    "\x1b[0;31mE ({ms}) task_wdt:  - IDLE (CPU 0)\x1b[0m",
    "\x1b[0;31mE ({ms}) task_wdt: Tasks currently running:\x1b[0m",
    "\x1b[0;31mE ({ms}) task_wdt: CPU 0: simulated scan\x1b[0m",
    "\x1b[0;31mE ({ms}) task_wdt: CPU 1: IDLE\x1b[0m",
    "\x1b[0;31mE ({ms}) task_wdt: Print CPU 0 (current core) backtrace\x1b[0m",
    "",
    "",
    "Backtrace: 0x40000010:0x30000010 0x40000020:0x30000020 0x40000030:0x30000030",
    "",
    "\x1b[0;31mE ({ms}) task_wdt: Print CPU 1 backtrace\x1b[0m",
    "",
    "",
    "Backtrace: 0x40000040:0x30000040 0x40000050:0x30000050",
    "",
)


def write_ert_board(path: Path, recording: Recording, transcript: Transcript) -> tuple[str, ...]:
    """Write a recording, row by row.

    A row's time, on either clock, is the mean of its readings' times, so that the middle of the first and the last
    row is the frame's. The computer reads each line when it is sent; the mass beside it is interpolated at that time
    and keeps its first and last value outside the samples. The scale is that of readings away from the driven
    electrodes, which are a tenth of the others: driven pairs are cut.

    Returns
    -------
    What the file does not say, in words.
    """
    lab_files.refuse_unfit(NAME, path, recording, transcript, BOARDS)
    row_s: Array = lab_files.reading_times(NAME, recording, transcript, "measure").mean(axis=2)
    _refuse_too_long(float(row_s[-1, -1] - row_s[0, 0]))
    gain = scale_of(recording.frames.voltages)
    dumps_by_frame: dict[int, Dumps] = defaultdict(dict)
    for dump in transcript.dumps:
        dumps_by_frame[dump.frame].setdefault(dump.row, []).append(dump)
    with lab_files.new_text_file(path) as file:
        file.write(lab_files.utc_line(recording) + TITLES + "\n")
        port = _Port(file, lab_files.channel(recording, "force", "N"), float(row_s[0, 0]))
        for frame, volts in enumerate(recording.frames.voltages):
            counts = np.rint(np.clip(volts * gain, -END_COUNTS, END_COUNTS)).astype(np.int64).tolist()
            _write_frame(port, row_s[frame].tolist(), counts, transcript.lost[frame], dumps_by_frame[frame])
    return (
        *_describe_conversion(recording, gain),
        *lab_files.list_omissions(recording, transcript, ("force",), ~ReadingFlag.NONE),
    )


def scale_of(voltages_V: Array) -> float:
    """Counts per volt for frames (n, pairs, pairs): what their used readings usually are fills the 16 bits."""
    usual = np.median(np.abs(voltages_V), axis=0)
    return counts_per_volt(_HEADROOM * float(usual[adjacent_pattern(len(usual)).usable()].max() or usual.max()))


def counts_per_volt(largest_V: float) -> float:
    """Return the largest of 1, 2, 5 × 10^k counts per volt by which a reading stays within :data:`MOST_COUNTS`."""
    if not largest_V > 0:
        raise RefusedError(f"all readings are {largest_V:g} V: {NAME} has no scale", remedy="drive a current")
    decade = int(np.floor(np.log10(MOST_COUNTS / largest_V)))
    steps = [float(f"{digit}e{decade + k}") for k in (-1, 0, 1) for digit in (1, 2, 5)]
    return max(step for step in steps if np.rint(step * largest_V) <= MOST_COUNTS)


class _Port:
    """What comes out of the board, with the recorder's time and the load cell before it.

    Parameters
    ----------
    force : compression positive; None where the load cell is off, which writes zeros.
    zero_s : when the recorder starts.
    """

    def __init__(self, file: TextIO, force: SampleBlock | None, zero_s: float) -> None:
        self._file, self._zero_s = file, zero_s
        self._time_s = np.zeros(1) if force is None else force.time_s
        self._mass_g = np.zeros(1) if force is None else -force.values / NEWTON_PER_GRAM
        self.now_s = zero_s

    def board_ms(self, time_s: float) -> int:
        return FIRST_BOARD_MS + round(1000 * (time_s - self._zero_s))

    def line(self, time_s: float, payload: str) -> None:
        mass_g = round(float(np.interp(time_s, self._time_s, self._mass_g)), 4) + 0.0  # no -0
        self._file.write(f"{time_s - self._zero_s:.6f},{mass_g:g},{payload}\n")
        self.now_s = time_s


Dumps = dict[int, list[Dump]]


def _write_frame(
    port: _Port, row_s: Sequence[float], counts: Sequence[Sequence[int]], lost: NDArray[np.bool_], dumps: Dumps
) -> None:
    """Write a mark and the rows that arrive. The mark is lost if all are."""
    for row, time_s in enumerate(row_s):
        begin_s = max(port.now_s, time_s - sum(dump.pause_s for dump in dumps.get(row, ())))
        if row == 0 and not lost.all():
            port.line(begin_s, "A")
        for dump in dumps.get(row, ()):
            begin_s = _write_dump(port, begin_s, min(begin_s + dump.pause_s, time_s))
        if not lost[row]:
            port.line(time_s, f"{port.board_ms(time_s)},{','.join(map(str, counts[row]))},")


def _write_dump(port: _Port, start_s: float, end_s: float) -> float:
    """Write a dump's lines evenly over its pause; return when it is over."""
    said_ms = port.board_ms(start_s)
    for k, text in enumerate(_DUMP):
        port.line(start_s + k / len(_DUMP) * (end_s - start_s), text.format(ms=said_ms))
    return end_s


def _describe_conversion(recording: Recording, gain: float) -> list[str]:
    """Describe the conversion of volts, amperes and times."""
    notes = [
        f"{gain:g} counts per volt: readings are rounded to {1e6 / gain:g} µV; the file does not state the scale",
        "rows carry the mean time of their readings, in whole milliseconds",
    ]
    cut = int((np.abs(recording.frames.voltages * gain) > END_COUNTS).any(axis=0).sum())
    if cut:
        count, at_V = recording.frames.voltages[0].size, END_COUNTS / gain
        notes.append(f"{cut} of the {count} readings, most of them at driven electrodes, are cut at {at_V:.3g} V")
    if recording.frames.current_A is not None:
        notes.append(f"the drive current of {1e3 * recording.frames.current_A:g} mA is not written")
    return notes


def _refuse_too_long(duration_s: float) -> None:
    most_s = (LAST_BOARD_MS - FIRST_BOARD_MS) / 1000
    if duration_s > most_s:
        raise RefusedError(
            f"the recording lasts {duration_s:.0f} s; the board's clock counts up to {most_s:.0f} s",
            remedy="record for less time, or write cbsr-recording",
        )
