"""The calibration file: HDF5, readable from MATLAB, LabVIEW, C and Python, and never executing anything.

Every value is a dataset with an attribute ``units``. Texts are UTF-8 strings, yes and no are one byte (0 or 1),
a number that does not exist is NaN, an index that does not exist is −1, an optional array that does not exist is
empty. Attributes of the root say ``format``, ``schema_version`` and ``digest``, which is of the content, not of the
file's bytes (see :mod:`cbsr_qa.calibrate.digests`): copying or repacking a file with another HDF5 library keeps it.
Schema version 1 had no group ``force``, version 2 matrix and Jacobian in double precision; what holds no more is
still written so. Large arrays are compressed (gzip with byte shuffle, which every HDF5 library reads).

The Jacobian is kept beside the matrix: it is the physical prior for places and reading sets no load has calibrated,
and without it a file could not be prepared for a sensor that lost a channel.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibrate._content import Entry
from cbsr_qa.calibrate._decode import decode
from cbsr_qa.calibrate._encode import encode
from cbsr_qa.calibrate.digests import FORMAT, SCHEMA_VERSION, content_digest, record_digest, schema_version
from cbsr_qa.domain.calibration import Calibration
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.files import written_whole

#: More than any calibration holds, all in all; a file that claims more is refused before memory is taken for it.
_LARGEST_BYTES: Final = 2**30
#: Names and texts in a list, more than any calibration has: a few bytes of a file can claim millions of either.
_MOST_NAMES: Final = 10_000
_MOST_TEXTS: Final = 100_000
_DIGEST: Final = re.compile("[0-9a-f]{64}")
#: Arrays from this size on are compressed; below it a chunk costs more than it saves.
_COMPRESSED_BYTES: Final = 2**13
#: How far gzip looks back for bytes it has seen.
_LOOKS_BACK: Final = 2**15


@dataclass(frozen=True, slots=True)
class VerifiedFile:
    """What was found out about a sound calibration file; digests as in :mod:`cbsr_qa.calibrate.digests`."""

    path: Path
    schema_version: int
    digest: str
    record_digest: str
    datasets: int


def write_calibration(path: Path, calibration: Calibration) -> str:
    """Write a calibration file; either the whole file appears under its name or nothing does.

    Returns
    -------
    The digest.

    Raises
    ------
    CalibrationError
        If the folder cannot be written, the calibration contradicts itself, or it is not what was issued: it has a
        ``record_digest`` that its content does not have.
    """
    entries = _as_issued(calibration)
    try:
        digest = content_digest(entries)
        content = _in_memory(entries, digest)
        with written_whole(path) as file:
            file.write(content)
    except OSError as error:
        raise CalibrationError(
            f"the calibration file {path} cannot be written: {error.strerror or error}",
            remedy="give a folder that exists and may be written, with room for some megabytes",
        ) from error
    except ValueError as error:
        raise CalibrationError(f"the calibration holds a text that cannot be written: {error}") from error
    return digest


def _in_memory(entries: Mapping[str, Entry], digest: str) -> bytes:
    """Return the file's bytes: HDF5 itself is kept off the disk, since a full one makes it crash the program."""
    with h5py.File("calibration.h5", "w", driver="core", backing_store=False) as file:
        _write(file, entries, digest)
        file.flush()
        return bytes(file.id.get_file_image())


def read_calibration(path: Path) -> Calibration:
    """Read a calibration file whose digest and schema are sound.

    Raises
    ------
    CalibrationError
        If it is not there, truncated, edited since it was issued, of a later version, or not a calibration.
    """
    with _naming(path):
        entries, digest = _read(path)
        return replace(decode(entries), digest=digest, record_digest=record_digest(entries))


def verify_calibration(path: Path) -> VerifiedFile:
    """Check digest and schema of a calibration file.

    Raises
    ------
    CalibrationError
        As :func:`read_calibration`.
    """
    with _naming(path):
        entries, digest = _read(path)
        decode(entries)
        return VerifiedFile(path, schema_version(entries), digest, record_digest(entries), len(entries))


def _as_issued(calibration: Calibration) -> Mapping[str, Entry]:
    entries = encode(calibration)
    if calibration.record_digest and record_digest(entries) != calibration.record_digest:
        raise CalibrationError(
            f"calibration {calibration.calibration} of sensor {calibration.sensor.serial} is not what was issued:"
            " its content was changed since",
            remedy="issue a new one; a sensor's values are changed by calibrating it again",
        )
    return entries


def _write(file: h5py.File, entries: Mapping[str, Entry], digest: str) -> None:
    file.attrs["format"] = FORMAT
    file.attrs["schema_version"] = np.int64(schema_version(entries))
    file.attrs["digest"] = digest
    for path, entry in entries.items():
        if isinstance(entry.value, np.ndarray):
            data = entry.value.astype(np.uint8) if entry.value.dtype == np.bool_ else entry.value
            dataset = file.create_dataset(path, data=data, **_packing(path, data))
        else:
            texts = entry.value if isinstance(entry.value, str) else np.array(entry.value, dtype=object)
            dataset = file.create_dataset(path, data=texts, dtype=h5py.string_dtype())
        dataset.attrs["units"] = entry.units


def _packing(path: str, data: NDArray[Any]) -> dict[str, Any]:
    """How an array is compressed."""
    if data.nbytes < _COMPRESSED_BYTES:
        return {}
    packing: dict[str, Any] = {"compression": "gzip", "shuffle": True}
    if path == "reconstruction/jacobian":
        # A reading and its reciprocal have the same row, which is found again if the chunk holds some columns of all.
        columns = min(max(_LOOKS_BACK // data.shape[0], 1), data.shape[1])
        packing["chunks"] = (data.shape[0], columns)
    return packing


def _read(path: Path) -> tuple[dict[str, Entry], str]:
    check_is_file(path)
    try:
        with h5py.File(path, "r") as file:
            version = _version(file)
            entries = dict(_entries(file, "", _Room(_LARGEST_BYTES)))
            stated = _stated(file)
    except (OSError, RuntimeError, KeyError, UnicodeDecodeError) as error:
        raise CalibrationError(
            f"not a whole HDF5 file (truncated, damaged or something else): {error}",
            remedy="copy it again from where it was issued",
        ) from error
    digest = content_digest(entries, version)
    if digest != stated:
        raise CalibrationError(
            f"the content was changed after it was issued: its SHA-256 is {digest},"
            f" the file states {stated or 'no SHA-256'}",
            remedy="use the file as it was issued; a sensor's values are changed by calibrating it again",
        )
    if version != schema_version(entries):
        raise CalibrationError(
            f"written to schema version {version}, but what it holds is that of version {schema_version(entries)}"
        )
    return entries, digest


def printable(text: str) -> str:
    """Return a text without control characters: names in a file may be anything, and a terminal obeys them."""
    return "".join(character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in text)


def check_is_file(path: Path) -> None:
    """Make sure that there is a file to read.

    Raises
    ------
    CalibrationError
        If there is none, or something else: a folder, a device.
    """
    try:
        there, usual = path.exists(), path.is_file()
    except OSError as error:
        raise CalibrationError(f"cannot be read: {error.strerror or error}") from error
    if not there:
        raise CalibrationError("there is no such file")
    if not usual:
        raise CalibrationError("a folder or a device, not a file")


def _stated(file: h5py.File) -> str:
    """Return the digest a file states; empty where it states what is none, and might be anything."""
    stated = file.attrs.get("digest")
    return stated if isinstance(stated, str) and _DIGEST.fullmatch(stated) else ""


def _version(file: h5py.File) -> int:
    stated = file.attrs.get("format")
    if not (isinstance(stated, str) and stated == FORMAT):
        raise CalibrationError("an HDF5 file, but not a calibration", remedy="give a file that `cbsr-qa run` issued")
    version = file.attrs.get("schema_version")
    if not isinstance(version, np.integer):
        raise CalibrationError("the schema version is missing or no whole number")
    if version > SCHEMA_VERSION:
        raise CalibrationError(
            f"written to schema version {version}; this program knows versions up to {SCHEMA_VERSION}",
            remedy="update cbsr-qa",
        )
    if version < 1:
        raise CalibrationError(f"schema version {version} never existed")
    return int(version)


class _Room:
    """What a file may still claim."""

    def __init__(self, left: int) -> None:
        self._left = left
        self._names = 0

    def enter(self, path: str) -> None:
        self._names += 1
        if self._names > _MOST_NAMES:
            raise CalibrationError(f"more than {_MOST_NAMES} names up to {path}: no calibration has as many")

    def take(self, path: str, dataset: Any) -> None:
        if dataset.size is None or dataset.nbytes > self._left:
            raise CalibrationError(f"{path} is empty or too large for a calibration")
        self._left -= dataset.nbytes


def _entries(group: h5py.Group, prefix: str, room: _Room) -> Iterator[tuple[str, Entry]]:
    for name in group:
        path = f"{prefix}{name}"
        room.enter(path)
        # Links could lead out of the file, or around in circles; nothing we write has any.
        if not isinstance(group.get(name, getlink=True), h5py.HardLink) or path.count("/") > 4:
            raise CalibrationError(f"{path} is a link, not content")
        item = group[name]
        if isinstance(item, h5py.Group):
            yield from _entries(item, f"{path}/", room)
        else:
            yield path, _entry(path, item, room)


def _entry(path: str, dataset: Any, room: _Room) -> Entry:
    if not isinstance(dataset, h5py.Dataset) or dataset.external or dataset.is_virtual:
        raise CalibrationError(f"{path} does not hold its own data")
    room.take(path, dataset)
    units = dataset.attrs.get("units")
    if not isinstance(units, str):
        raise CalibrationError(f"{path} states no units")
    if h5py.check_string_dtype(dataset.dtype) is not None:
        if dataset.ndim > 1 or dataset.size > _MOST_TEXTS:
            raise CalibrationError(f"{path} holds texts of the shape {dataset.shape}; a list of them is expected")
        texts = dataset.asstr()[()]
        return Entry(units, texts if isinstance(texts, str) else tuple(texts.tolist()))
    values = np.asarray(dataset[()])
    if values.dtype == np.float64:
        return Entry(units, values.astype(np.float64))
    if values.dtype == np.float32:
        return Entry(units, values.astype(np.float32))
    if values.dtype == np.int64:
        return Entry(units, values.astype(np.int64))
    if values.dtype == np.uint8 and values.max(initial=0) <= 1:
        return Entry(units, values.astype(np.bool_))
    raise CalibrationError(f"{path} is of the type {dataset.dtype}, or holds a value, that no calibration has")


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Put the file's name before whatever is said about it."""
    try:
        yield
    except CalibrationError as error:
        reason = printable(error.reason)
        raise CalibrationError(f"calibration file {path}: {reason}", remedy=error.remedy) from error
