"""Reading and writing of the lab's text files: bounded lines, the mark of simulated files, refusals and remarks.

A file that was simulated says so in further fields of its ``UTC:`` line. Readers skip that line, so the mark disturbs
none, and ours find it.
"""

import math
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from typing import Final, TextIO

import numpy as np

from cbsr_qa.analysis.recording_files import recording_file
from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import (
    ReadingFlag,
    ReadOptions,
    Recording,
    RecordingError,
    RefusedError,
    SampleBlock,
    ScanKind,
    Transcript,
    VoltageUnit,
    adjacent_pattern,
)
from cbsr_qa.system.foreign import open_foreign

#: Characters of a line that are looked at. Rows of readings have a few hundred; a binary file may have no line end.
LONGEST_LINE: Final = 1 << 14
#: After this many lines in a row without a reading the rest of a file is not looked at.
MOST_BAD_IN_A_ROW: Final = 5000


@dataclass(frozen=True, slots=True)
class TextLine:
    """One line.

    Parameters
    ----------
    number : 1-based.
    text : without its line end, and without NULs at its ends (file systems pad files with them after a crash).
    ended : whether a line end follows; False only for the last line of a file.
    too_long : whether ``text`` is only its beginning.
    """

    number: int
    text: str
    ended: bool
    too_long: bool


def text_lines(path: Path) -> Iterator[TextLine]:
    """Read a file line by line; bytes that are no UTF-8 come out as replacement characters."""
    with TextIOWrapper(open_foreign(path), encoding="utf-8-sig", errors="replace") as file:
        number = 0
        while text := file.readline(LONGEST_LINE):
            number += 1
            rest = text
            while rest and not rest.endswith("\n"):
                rest = file.readline(LONGEST_LINE)
            too_long = len(text) == LONGEST_LINE and not text.endswith("\n")
            yield TextLine(number, text.rstrip("\n").strip("\x00"), bool(rest), too_long)


class OneDataSet:
    """A format whose files are one data set each."""

    def datasets(self, path: Path) -> tuple[str, ...]:
        return ()

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read a file.

        Raises
        ------
        RecordingError
            If a data set was chosen, or the file cannot be used; with the problems of its rows.
        """
        if options.dataset:
            raise RecordingError(
                f"{path.name} is one data set; it has none named {options.dataset!r}", remedy="leave the name out"
            )
        return self._read(path)

    def _read(self, path: Path) -> Recording:
        raise NotImplementedError


def number(text: str) -> float | None:
    """Return a finite number; None where the text is anything else."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


_MARK: Final = "simulated: "
#: Characters for all fields together: the titles must lie within the first 4096 bytes, by which files are recognised.
_MAX_FIELD_LENGTH: Final = 900
_NOT_IN_A_FIELD: Final = str.maketrans({",": ";", '"': "'", "\n": " ", "\r": " "})


def mark(simulated: Iterable[str]) -> str:
    """Further fields of a ``UTC:`` line, each after a comma; empty if nothing was simulated."""
    fields = "".join(f",{_MARK}{what.translate(_NOT_IN_A_FIELD)}" for what in simulated)
    return fields if len(fields) <= _MAX_FIELD_LENGTH else fields[:_MAX_FIELD_LENGTH] + " …"


def find_simulation_marks(lines: Iterable[str]) -> tuple[str, ...]:
    """What ``UTC:`` lines say was simulated, each thing once; empty for a real rig's."""
    fields = (field.strip() for line in lines for field in line.split(","))
    return tuple(dict.fromkeys(field.removeprefix(_MARK) for field in fields if field.startswith(_MARK)))


#: Date of every file that is written: a clock's would make two files of one scene differ.
WRITTEN_UTC: Final = "2000-01-01 00:00:00.000000"
#: Of the rig with a source-measure unit behind a multiplexer, and of the authors' board.
ELECTRODES: Final = 16
#: From this share of frames that lose rows on readers cannot tell any more how the frames follow each other.
_MAX_LOST_SHARE: Final = 0.5
_OWN_FORMAT: Final = "write cbsr-recording"


def utc_line(recording: Recording) -> str:
    """First line of a file, which also says what was simulated."""
    return f"UTC:,{WRITTEN_UTC}{mark(recording.simulated)}\n"


def refuse_existing(path: Path) -> None:
    """RefusedError if the file exists."""
    if path.exists():
        raise RefusedError(f"{path} exists already", remedy="name another file, or remove it first")


def refuse_unfit(
    name: str, path: Path, recording: Recording, transcript: Transcript, counts: tuple[int, ...] = (ELECTRODES,)
) -> None:
    """Refuse what the lab's rigs cannot have recorded.

    Parameters
    ----------
    name : of the format.
    counts : numbers of electrodes that its rig is built with.

    Raises
    ------
    RefusedError
        If the file exists, or the recording is not of volts of adjacent scans of so many electrodes, with a row of
        the transcript for each of theirs, every reading of them there, and more than half of the frames whole.
    """
    refuse_existing(path)
    _refuse_kind(name, recording)
    pattern = transcript.setting.sensor_type.pattern
    electrodes = pattern.electrode_count
    if electrodes not in counts or pattern != adjacent_pattern(electrodes):
        allowed = " or ".join(map(str, counts))
        raise RefusedError(
            f"{name} holds the adjacent pattern of {allowed} electrodes; this one drives {len(pattern.drive)}"
            f" pairs of {electrodes} and measures {len(pattern.measure)}",
            remedy=f"{_OWN_FORMAT}, or simulate a sensor type of {allowed} electrodes with the adjacent pattern",
        )
    shape = (len(recording.frames), electrodes)
    if recording.frames.voltages.shape != (*shape, electrodes) or transcript.lost.shape != shape:
        raise RefusedError(
            f"a transcript of {transcript.lost.shape[0]} frames of {transcript.lost.shape[1]} rows is not that of"
            f" readings of shape {recording.frames.voltages.shape}",
            remedy="write all frames with the transcript they were taken with",
        )
    missing = np.argwhere(recording.frames.flags & ReadingFlag.MISSING.value)
    if len(missing):
        frame, drive, measure = missing[0].tolist()
        raise RefusedError(
            f"{name} has no way to leave out a reading; {len(missing)} are missing, the first in frame {frame}"
            f" (drive pair {drive}, measure pair {measure})",
            remedy=_OWN_FORMAT,
        )
    count, broken = len(transcript.lost), int(transcript.lost.any(axis=1).sum())
    if not count or broken >= _MAX_LOST_SHARE * count:
        raise RefusedError(
            f"{broken} of {count} frames lose rows; readers of {name} find frames again among whole ones",
            remedy=f"let fewer than half of the frames lose rows, or {_OWN_FORMAT}",
        )


def _refuse_kind(name: str, recording: Recording) -> None:
    kinds = (
        (recording.frames.unit is not VoltageUnit.VOLT, "counts"),
        (recording.magnitudes_only, "magnitudes"),
        (recording.still, "still images"),
        (recording.scan is not ScanKind.FULL, "of driven pairs alone"),
    )
    if other := [what for is_so, what in kinds if is_so]:
        raise RefusedError(
            f"{name} is written from volts with their signs, of whole scans in time; these are {', '.join(other)}",
            remedy=_OWN_FORMAT,
        )


def reading_times(name: str, recording: Recording, transcript: Transcript, order: str) -> Array:
    """When each reading was taken, (frames, drives, measures) in canonical order [s].

    Where a recording has no times of readings, its frames are taken at once: each reading has its frame's time.

    Parameters
    ----------
    name : of the format.
    order : which pair steps faster on its rig: ``"measure"`` or ``"drive"``.
    """
    frames = recording.frames
    times_s = frames.reading_time_s
    if times_s is None:
        times_s = np.broadcast_to(frames.time_s[:, None, None], frames.voltages.shape)
    scan = times_s if order == "measure" else times_s.swapaxes(1, 2)
    step_s = np.diff(scan.reshape(-1))
    if not np.isfinite(times_s).all() or (step_s < 0).any():
        frame = int(np.argmax(~(step_s >= 0))) // times_s[0].size
        # Dumps are those of a board that reads row by row.
        without_dumps = " and take watchdog-dump out" if order == "drive" and transcript.dumps else ""
        raise RefusedError(
            f"{name} is of a rig whose {order} pair steps faster; the times of frame {frame} fall in that order",
            remedy=f'give time-skew inner = "{order}"{without_dumps}, or {_OWN_FORMAT}',
        )
    return times_s


def channel(recording: Recording, name: str, unit: str) -> SampleBlock | None:
    """Samples of a channel; None if there are none."""
    return next((s for s in recording.samples if (s.channel, s.unit) == (name, unit) and len(s)), None)


def list_omissions(
    recording: Recording, transcript: Transcript, carried: Collection[str], flags: ReadingFlag
) -> list[str]:
    """Say what neither of the lab's formats holds.

    Parameters
    ----------
    carried : channels that are written.
    flags : of readings that the format does not hold.
    """
    channels = [s.channel for s in recording.samples if s.channel not in carried]
    flagged = int(np.count_nonzero(recording.frames.flags & flags.value))
    broken = int(transcript.lost.any(axis=1).sum())
    remarks = (
        (channels, f"channels that are not written: {', '.join(channels)}"),
        (recording.loads, f"the {len(recording.loads)} presses are not written: the format documents none"),
        (
            recording.sensor_type is not None or recording.layout is not None,
            "sensor type and numbering of the electrodes are not written: name --sensor-type to analyse",
        ),
        (recording.reference is not None, "the reference frames are not written"),
        (recording.notes, f"what the recording notes is not written: {'; '.join(recording.notes)}"),
        (flagged, f"{flagged} readings are flagged, which is not written; their values are"),
        (
            recording.frames.reading_time_s is None,
            "the readings of a frame are taken at once: all are written with the frame's time",
        ),
        (broken, f"{broken} of {len(transcript.lost)} frames lost rows; what arrived of them is written"),
    )
    return [remark for applies, remark in remarks if applies]


@contextmanager
def new_text_file(path: Path) -> Iterator[TextIO]:
    """Write a text file whole or not at all."""
    with recording_file(path) as file:
        text = TextIOWrapper(file, encoding="utf-8", newline="\n")
        yield text
        text.detach()
