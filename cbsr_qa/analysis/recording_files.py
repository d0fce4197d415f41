"""The recording file: HDF5 with a schema version, units on every dataset, and a digest.

It holds frames, reading flags, times, samples of other channels, and documented presses. Nothing in it is executable;
datasets are plain numbers and UTF-8 text, readable from MATLAB, LabVIEW, C and Python.
"""

import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.recording_entries import (
    Description,
    group_of,
    json_of,
    numbers,
    real_of,
    text_of,
    texts,
    unit_of,
    validate_entry,
)
from cbsr_qa.calibration.file.hdf5_content import attribute, attribute_names, members
from cbsr_qa.domain.errors import CbsrError, RecordingError, RefusedError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import FrameBlock, Recording, SampleBlock, ScanKind, VoltageUnit
from cbsr_qa.domain.readings.loads import Load, LoadRecord
from cbsr_qa.system.files import write_atomically, writing
from cbsr_qa.system.foreign import open_foreign
from cbsr_qa.system.words import echo

FORMAT: Final = "cbsr-recording"
SCHEMA_VERSION: Final = 1
SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"

#: Size of a file with our own content [bytes].
_ANY_SIZE: Final = 2**40

#: Prefix of notes in files without their own ``simulated``.
_SIMULATED_NOTE: Final = "simulated: "

#: Fields of a recording stored in the attribute ``description``.
_DESCRIBED: Final = ("dataset", "still", "magnitudes_only", "clock", "sensor_type")

_LOAD_COLUMNS: Final = (
    ("x_mm", "mm"),
    ("y_mm", "mm"),
    ("strain", "1"),
    ("press_start_s", "s"),
    ("hold_start_s", "s"),
    ("release_start_s", "s"),
    ("release_end_s", "s"),
    ("rest_end_s", "s"),
)


def write_recording(path: Path, recording: Recording) -> None:
    """Write a recording atomically.

    Parameters
    ----------
    recording : problems of the file it was read from are not written; its notes are.

    Raises
    ------
    RecordingError
        If the folder cannot be written to.
    """
    with recording_file(path) as file:
        file.write(_image(recording))


@contextmanager
def recording_file(path: Path) -> Iterator[BinaryIO]:
    """Write a recording file of any format, atomically.

    Raise RecordingError if the folder cannot be written to.
    """
    with writing(path, refusal=RecordingError, remedy="choose a writable folder"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(path) as file:
            yield file


def _image(recording: Recording) -> bytes:
    """Content of the file. Built in memory: HDF5 prints tracebacks when a disk is full, and cannot close its file."""
    with h5py.File("recording.h5", "w", driver="core", backing_store=False) as file:
        _write(file, recording)
        file.attrs["sha256"] = _digest(file)
        file.flush()
        return bytes(file.id.get_file_image())


def read_recording(path: Path) -> Recording:
    """Read a recording back.

    Raises
    ------
    RecordingError
        If the file is not a recording file, truncated, edited (its digest does not match), or of a later version.
    """
    try:
        # Open the file by its bytes: HDF5 shares a file that the program has open, even if that descriptor is closed.
        with open_foreign(path) as data, h5py.File(data, "r") as file:
            _check(path, file)
            return _read(path, file)
    except RecordingError:
        raise
    except CbsrError as error:
        raise RecordingError(f"{path.name}: {error.reason}", remedy=error.remedy or "export the run again") from error
    except (OSError, LookupError, ValueError, TypeError, ArithmeticError, AttributeError, RuntimeError) as error:
        raise RecordingError(
            f"{path.name} is damaged: HDF5 cannot read it ({error})",
            remedy="export the run again, or copy the file again",
        ) from error


def _check(path: Path, file: h5py.File) -> None:
    if attribute(file, "format") != FORMAT:
        raise RecordingError(
            f"{path.name} is an HDF5 file but not a recording of this program",
            remedy="use cbsr-qa calibration show for a calibration file",
        )
    version = attribute(file, "schema_version")
    if not isinstance(version, np.integer):
        raise RecordingError(f"{path.name} has no schema version, or not a whole number")
    if not 1 <= version <= SCHEMA_VERSION:
        raise RecordingError(
            f"{path.name} has schema version {version}; this program reads up to {SCHEMA_VERSION}",
            remedy="update cbsr-qa",
        )
    if attribute(file, "sha256") != _digest(file, path.stat().st_size):
        raise RecordingError(
            f"{path.name} was changed after it was written (its digest does not match)", remedy="export the run again"
        )


def _write(file: h5py.File, recording: Recording) -> None:
    file.attrs["format"] = FORMAT
    file.attrs["schema_version"] = SCHEMA_VERSION
    described: dict[str, Any] = {name: getattr(recording, name) for name in _DESCRIBED} | {
        "scan": recording.scan.value,
        "layout": None if recording.layout is None else asdict(recording.layout),
        "notes": list(recording.notes),
        "simulated": list(recording.simulated),
    }
    if recording.frames_dropped:
        described["frames_dropped"] = recording.frames_dropped
    if recording.serial is not None:
        described["serial"] = recording.serial
    file.attrs["description"] = json.dumps(described, ensure_ascii=False, sort_keys=True)
    _write_frames(file.create_group("frames"), recording.frames)
    if recording.reference is not None:
        _write_frames(file.create_group("reference"), recording.reference)
    for k, block in enumerate(recording.samples):
        group = file.create_group(f"samples/{k:02d}")
        group.attrs["channel"] = block.channel
        _put(group, "time_s", block.time_s, "s")
        _put(group, "values", block.values, block.unit)
    if recording.loads:
        _write_loads(file.create_group("loads"), recording.loads)


def _write_frames(group: h5py.Group, block: FrameBlock) -> None:
    group.attrs["order"] = "frame, drive pair, measure pair"
    if block.current_A is not None:
        group.attrs["current_A"] = block.current_A
    _put(group, "time_s", block.time_s, "s")
    _put(group, "voltages", block.voltages, block.unit.value)
    _put(group, "flags", block.flags, "bits: 1 saturated, 2 compliance, 4 missing")
    if block.reading_time_s is not None:
        _put(group, "reading_time_s", block.reading_time_s, "s")


def _write_loads(group: h5py.Group, loads: tuple[LoadRecord, ...]) -> None:
    group.attrs["labels"] = json.dumps([load.load.label for load in loads])
    _put(group, "index", np.array([load.index for load in loads]), "1")
    _put(group, "trial", np.array([load.load.trial for load in loads]), "1")
    for name, unit in _LOAD_COLUMNS:
        column = [getattr(load.load if hasattr(load.load, name) else load, name) for load in loads]
        _put(group, name, np.array(column, dtype=np.float64), unit)
    if any(load.clear_s is not None for load in loads):
        cleared = [np.nan if load.clear_s is None else load.clear_s for load in loads]
        _put(group, "clear_s", np.array(cleared, dtype=np.float64), "s")


def _put(group: h5py.Group, name: str, values: NDArray[Any], unit: str) -> None:
    compressed = {"compression": "gzip", "shuffle": True} if values.size > 1024 else {}
    group.create_dataset(name, data=values, track_times=False, **compressed).attrs["unit"] = unit


def _read(path: Path, file: h5py.File) -> Recording:
    description = validate_entry(Description, json_of(file, "description"), "description")
    notes, simulated = _notes(description)
    return Recording(
        path=path,
        format=FORMAT,
        scan=ScanKind(description.scan),
        frames=_read_frames(group_of(file, "frames")),
        reference=_read_frames(group_of(file, "reference")) if "reference" in file else None,
        samples=_read_samples(group_of(file, "samples")) if "samples" in file else (),
        loads=_read_loads(group_of(file, "loads")) if "loads" in file else (),
        layout=description.electrodes(),
        notes=notes,
        frames_dropped=description.frames_dropped,
        simulated=simulated,
        serial=description.serial,
        **{name: getattr(description, name) for name in _DESCRIBED},
    )


def _notes(description: Description) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return notes and the simulation's description, which earlier versions stored as notes."""
    if description.simulated is not None:
        return tuple(description.notes), tuple(description.simulated)
    simulated_notes = [note for note in description.notes if note.startswith(_SIMULATED_NOTE)]
    other_notes = tuple(note for note in description.notes if note not in simulated_notes)
    return other_notes, tuple(note.removeprefix(_SIMULATED_NOTE) for note in simulated_notes)


def _read_frames(group: h5py.Group) -> FrameBlock:
    current_A = real_of(group, "current_A", "the drive current")
    if current_A is not None and current_A <= 0:
        raise RefusedError(f"the drive current (current_A of {group.name}) is {current_A:g} A; it must be above 0")
    reading_times_s = numbers(group, "reading_time_s") if "reading_time_s" in group else None
    times_s = numbers(group, "time_s")
    if not np.isfinite(times_s).all() or (np.diff(times_s) < 0).any():
        raise RefusedError("frame times must be finite and must not decrease")
    if reading_times_s is not None and not np.isfinite(reading_times_s).all():
        raise RefusedError("the time of a reading is not a finite number")
    voltages, unit = numbers(group, "voltages"), unit_of(group, "voltages")
    if unit not in set(VoltageUnit):
        allowed = ", ".join(VoltageUnit)
        raise RefusedError(f"{group.name}/voltages has unit {echo(unit)}; allowed: {allowed}")
    flags = numbers(group, "flags", "iu").astype(np.uint8)
    return FrameBlock(times_s, voltages, flags, VoltageUnit(unit), current_A, reading_times_s)


def _read_samples(channels: h5py.Group) -> tuple[SampleBlock, ...]:
    blocks = []
    for key in sorted(channels):
        group = group_of(channels, key)
        times_s = numbers(group, "time_s")
        values = numbers(group, "values", shape=times_s.shape)
        finite_mask = np.isfinite(times_s) & np.isfinite(values)  # a lost sample is left out
        channel, unit = text_of(group, "channel"), unit_of(group, "values")
        blocks.append(SampleBlock(channel, unit, times_s[finite_mask], values[finite_mask]))
    return tuple(blocks)


def _read_loads(group: h5py.Group) -> tuple[LoadRecord, ...]:
    labels = texts(f"attribute labels of {group.name}", json_of(group, "labels"))
    shape = (len(labels),)
    columns = {name: numbers(group, name, shape=shape) for name, _ in _LOAD_COLUMNS}
    index, trial = (numbers(group, name, "iu", shape) for name in ("index", "trial"))
    for name, unit in _LOAD_COLUMNS:
        _check_finite(group, name, columns[name], unit, labels)
    # Missing if not recorded, as in files of earlier versions; NaN for single presses without it.
    cleared = numbers(group, "clear_s", shape=shape).tolist() if "clear_s" in group else [np.nan] * len(labels)
    _check_finite(group, "clear_s", np.nan_to_num(np.array(cleared), posinf=np.inf, neginf=-np.inf), "s", labels)
    rows: list[dict[str, Any]] = [
        dict(zip(columns, row, strict=True)) for row in np.column_stack(list(columns.values())).tolist()
    ]
    return tuple(
        LoadRecord(
            int(index[k]),
            Load(label, row.pop("x_mm"), row.pop("y_mm"), row.pop("strain"), int(trial[k])),
            **row,
            clear_s=None if np.isnan(cleared[k]) else cleared[k],
        )
        for k, (label, row) in enumerate(zip(labels, rows, strict=True))
    )


def _check_finite(group: h5py.Group, name: str, column: Array, unit: str, labels: Sequence[str]) -> None:
    for k in np.flatnonzero(~np.isfinite(column))[:1].tolist():
        raise RefusedError(
            f"{group.name}/{name}, row {k} (from 0), of load {echo(labels[k])}, is {column[k]:g} {unit};"
            " a finite number is expected"
        )


def _digest(file: h5py.File, size_bytes: int = _ANY_SIZE) -> str:
    """SHA-256 over names, shapes, types, values and attributes in sorted order, however HDF5 packs them.

    The whole file is checked (see :func:`~cbsr_qa.calibration.file.hdf5_content.members`) before any value is read.
    """
    sha = hashlib.sha256()
    item_by_name = dict(members(file, size_bytes))
    for name, item in [("/", file), *sorted(item_by_name.items())]:
        sha.update(name.encode() + b"\x00")
        if isinstance(item, h5py.Dataset):
            if item.dtype.kind not in "iufcb":
                raise RefusedError(f"{name} holds values of type {item.dtype}, not numbers")
            values = np.ascontiguousarray(item[()])
            sha.update(f"{values.shape}{values.dtype.str}".encode())
            sha.update(values.tobytes())
        for key in attribute_names(item):
            if key != "sha256":
                sha.update(f"{key}={attribute(item, key)!s}\x00".encode())
    return sha.hexdigest()
