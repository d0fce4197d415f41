"""The calibration file: HDF5, readable from MATLAB, LabVIEW, C and Python, without executable content.

Every value is a dataset with an attribute ``units``. Texts are UTF-8 strings, booleans are one byte (0 or 1), missing
numbers are NaN, missing indices are −1, missing optional arrays are empty. Attributes of the root are ``format``,
``schema_version`` and ``digest``, which covers the content, not the file's bytes (see
:mod:`cbsr_qa.calibration.file`), and so does not depend on the HDF5 library; a signed file also has ``public_key``,
``signed_at`` and ``signature`` (:mod:`cbsr_qa.calibration.file.signing`). The 512 bytes before the HDF5 file (its
user block, which every HDF5 library skips) hold a digest of all bytes after them. Large arrays are compressed (gzip
with byte shuffle, which every HDF5 library reads).
"""

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.file.content import (
    FORMAT,
    MOST_ENTRIES,
    PRESS_FORMAT,
    Entry,
    check_released,
    content_digest,
    format_of,
    latest_version,
    record_digest,
    schema_version,
)
from cbsr_qa.calibration.file.entries import Issued, decode, encode
from cbsr_qa.calibration.file.hdf5_content import attribute, members, texts
from cbsr_qa.calibration.file.keys import SigningKey
from cbsr_qa.calibration.file.signing import SIGNATURE, read_signature, with_signature
from cbsr_qa.domain.errors import CalibrationError, RefusedError
from cbsr_qa.domain.results.calibration import Calibration, VerifiedFile
from cbsr_qa.domain.results.press_calibration import PressCalibration
from cbsr_qa.domain.results.signature import Signature
from cbsr_qa.system.files import write_atomically, writing
from cbsr_qa.system.foreign import read_foreign
from cbsr_qa.system.untrusted import read_untrusted

_Kind = TypeVar("_Kind", bound=Issued)
_Result = TypeVar("_Result")

#: Largest size of a file: more than that of any calibration file.
_LARGEST_BYTES: Final = 2**28
#: Processor time for each megabyte [s]; the file of a run takes 0.1 s.
_SECONDS_PER_MB: Final = 0.25
_DIGEST: Final = re.compile("[0-9a-f]{64}")
#: Arrays from this size on are compressed; for smaller ones a chunk costs more than it saves.
_COMPRESSED_BYTES: Final = 2**13
#: gzip's window for repeated bytes.
_LOOKS_BACK: Final = 2**15

#: Size of the block before the HDF5 file: the smallest user block.
_BLOCK_BYTES: Final = 512
BLOCK_BEGINS: Final = b"cbsr-qa calibration file: HDF5 after these 512 bytes\n"
_SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
_NOT_WHOLE: Final = "not a whole HDF5 file (truncated, damaged or something else)"
_COPY_AGAIN: Final = "copy it again from where it was issued"


def stamp(calibration: _Kind) -> _Kind:
    """Return a calibration with its digests and the bytes of its file filled in.

    CalibrationError if it contradicts itself, or has a text that HDF5 cannot hold.
    """
    entries = encode(calibration)
    digest = content_digest(entries)
    file = _write_file(entries, digest)
    return replace(calibration, digest=digest, record_digest=record_digest(entries), file=file, signature=None)


def sign_calibration(calibration: _Kind, key: SigningKey, at: datetime) -> _Kind:
    """Return an issued calibration with its signature, and the bytes of its signed file.

    CalibrationError if its content was changed since it was issued.
    """
    entries = _as_issued(calibration)
    signed = with_signature(calibration, key, at)
    return replace(signed, file=_write_file(entries, signed.digest, signed.signature))


def write_calibration(path: Path, calibration: Issued) -> str:
    """Write a calibration file; either the whole file appears under its name or nothing does.

    Raises
    ------
    CalibrationError
        If the folder cannot be written, the calibration contradicts itself, or it differs from the issued one
        (another ``record_digest``).
    """
    entries = _as_issued(calibration)
    digest = content_digest(entries)
    if calibration.file and digest == calibration.digest:
        data = calibration.file
    else:
        data = _write_file(entries, digest, calibration.signature)
    remedy = "give a folder that exists and may be written, with room for some megabytes"
    with writing(path, refusal=CalibrationError, remedy=remedy):
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(path) as file:
            file.write(data)
    return digest


def _write_file(entries: Mapping[str, Entry], digest: str, signature: Signature | None = None) -> bytes:
    try:
        image = _write_to_memory(entries, digest, signature)
    except ValueError as error:
        raise CalibrationError(f"the calibration holds a text that cannot be written: {error}") from error
    return _block(image) + image


def _write_to_memory(entries: Mapping[str, Entry], digest: str, signature: Signature | None) -> bytes:
    """Return the file's bytes, built in memory because a full disk would crash HDF5."""
    with h5py.File("calibration.h5", "w", driver="core", backing_store=False, userblock_size=_BLOCK_BYTES) as file:
        _write(file, entries, digest)
        for name in SIGNATURE if signature else ():
            file.attrs[name] = getattr(signature, name)
        file.flush()
        return bytes(file.id.get_file_image())


def read_calibration(path: Path) -> Calibration:
    """Read a calibration file of a run, whose digest and schema are sound.

    Raises
    ------
    CalibrationError
        If it does not exist, is truncated, edited since issue, of a later version, or not a run's calibration.
    """
    issued = read_issued(path)
    with _name_file_in_errors(path):
        return require_run_calibration(issued)


def read_issued(path: Path) -> Issued:
    """Read a calibration file, of a run or of labelled presses. CalibrationError if it is not sound."""
    with _name_file_in_errors(path):
        return replace(_decode_file(file_bytes(path)), file=b"")  # a robot does not need megabytes of it


def require_run_calibration(issued: Issued) -> Calibration:
    """Return a run's calibration; CalibrationError if it was learned from labelled presses."""
    if isinstance(issued, PressCalibration):
        raise CalibrationError(
            "learned from labelled presses, not issued by a run",
            remedy="`cbsr-qa calibration apply FILE READINGS.csv --pattern PAIRS.csv` applies it,"
            " in Python `cbsr_qa.load_calibration`",
        )
    return issued


def calibration_of(data: bytes, *, issued: str = "") -> Calibration:
    """Return the calibration in the bytes of a file.

    CalibrationError as for :func:`read_calibration`, and if its digest differs from the issued one.
    """
    content = _decode_file(data)
    if issued and content.digest != issued:
        raise CalibrationError(
            f"its file holds another calibration: its SHA-256 is {content.digest}, {issued} was issued"
        )
    return require_run_calibration(content)


def _decode_file(data: bytes) -> Issued:
    entries, digest, _, signature = _read(data)
    issued = decode(entries)
    return replace(issued, digest=digest, record_digest=record_digest(entries), file=data, signature=signature)


def read_contained(path: Path) -> Calibration:
    """Read a run's calibration file of unknown origin; CalibrationError as the two functions that this one calls."""
    return read_in_child(path, partial(read_calibration, path))


def read_in_child(path: Path, read: Callable[[], _Result]) -> _Result:
    """Call a function that reads a calibration file of unknown origin (see :mod:`cbsr_qa.system.untrusted`).

    CalibrationError as the function, and if reading crashes, hangs or takes too much memory.
    """
    return read_untrusted(path, read, refusal=CalibrationError, seconds_per_mb=_SECONDS_PER_MB)


def verify_calibration_file(path: Path) -> VerifiedFile:
    """Check digest and schema of a calibration file; refused as by :func:`read_calibration`."""
    with _name_file_in_errors(path):
        entries, digest, checked, signature = _read(file_bytes(path))
        decode(entries)
        version = schema_version(entries)
        return VerifiedFile(path, version, digest, record_digest(entries), len(entries), checked, signature)


def _as_issued(calibration: Issued) -> Mapping[str, Entry]:
    entries = encode(calibration)
    changed = calibration.record_digest and record_digest(entries) != calibration.record_digest
    if changed or (calibration.signature and content_digest(entries) != calibration.digest):
        raise CalibrationError(
            f"{calibration!r} is not what was issued: its content was changed since",
            remedy="issue a new one; a sensor's values are changed by calibrating it again",
        )
    return entries


def _write(file: h5py.File, entries: Mapping[str, Entry], digest: str) -> None:
    file.attrs["format"] = format_of(entries)
    file.attrs["schema_version"] = np.int64(schema_version(entries))
    file.attrs["digest"] = digest
    for path, entry in entries.items():
        if isinstance(entry.value, np.ndarray):
            data = entry.value.astype(np.uint8) if entry.value.dtype == np.bool_ else entry.value
            dataset = file.create_dataset(path, data=data, **_packing(data))
        else:
            texts = entry.value if isinstance(entry.value, str) else np.array(entry.value, dtype=object)
            dataset = file.create_dataset(path, data=texts, dtype=h5py.string_dtype())
        dataset.attrs["units"] = entry.units


def _packing(data: NDArray[Any]) -> dict[str, Any]:
    if data.nbytes < _COMPRESSED_BYTES:
        return {}
    packing: dict[str, Any] = {"compression": "gzip", "shuffle": True}
    if data.ndim == 2:
        # Neighbouring places have like rows, and a reading and its reciprocal equal ones: a chunk holds some columns
        # of all rows.
        columns = min(max(_LOOKS_BACK // data.shape[0], 1), data.shape[1])
        packing["chunks"] = (data.shape[0], columns)
    return packing


def _read(data: bytes) -> tuple[dict[str, Entry], str, bool, Signature | None]:
    checked = _check_bytes(data)
    try:
        with h5py.File(h5py.h5f.open_file_image(data), "r") as file:
            format_, version = _read_version(file)
            items = members(file, len(data), MOST_ENTRIES)
            entries = {path: _entry(path, item) for path, item in items if isinstance(item, h5py.Dataset)}
            stated = attribute(file, "digest")
            stated_digest = stated if isinstance(stated, str) and _DIGEST.fullmatch(stated) else ""
            signature_parts = {name: attribute(file, name) for name in SIGNATURE if name in file.attrs}
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise CalibrationError(f"{_NOT_WHOLE}: {error}", remedy=_COPY_AGAIN) from error
    digest = content_digest(entries, version)
    if digest != stated_digest or format_ != format_of(entries):
        raise CalibrationError(
            f"the content was changed after it was issued: its SHA-256 is {digest},"
            f" the file states {stated_digest or 'no SHA-256'}",
            remedy="use the file as it was issued; a sensor's values are changed by calibrating it again",
        )
    if version != schema_version(entries):
        raise CalibrationError(
            f"written to schema version {version}, but what it holds is that of version {schema_version(entries)}"
        )
    return entries, digest, checked, read_signature(signature_parts)


def _block(image: bytes) -> bytes:
    """Return the user block before the HDF5 file: a digest of its bytes."""
    digest_line = f"SHA-256 of what follows them: {hashlib.sha256(image).hexdigest()}\n"
    return (BLOCK_BEGINS + digest_line.encode()).ljust(_BLOCK_BYTES, b"\0")


def _check_bytes(data: bytes) -> bool:
    """Compare the bytes of a file with the digest before them; False without one, as other programs copy a file.

    This precedes HDF5, which one changed byte can crash.
    """
    if data.startswith(_SIGNATURE):
        return False
    if data[:64].lstrip().startswith(b"{"):
        raise CalibrationError(
            "JSON, not HDF5, which is what this command takes",
            remedy="`cbsr-qa calibration export X.json --output X.h5` makes HDF5 of it",
        )
    if not data.startswith(BLOCK_BEGINS):
        raise CalibrationError(_NOT_WHOLE, remedy=_COPY_AGAIN)
    if data[:_BLOCK_BYTES] != _block(data[_BLOCK_BYTES:]):
        raise CalibrationError(
            "truncated, damaged, or changed after it was issued: the SHA-256 of its bytes is not the one it states",
            remedy=_COPY_AGAIN,
        )
    return True


def file_bytes(path: Path) -> bytes:
    """Return all bytes of a calibration file.

    CalibrationError if it does not exist, is not a file, cannot be read, or is too large for a calibration.
    """
    try:
        return read_foreign(path, _LARGEST_BYTES)
    except FileNotFoundError as error:
        raise CalibrationError("there is no such file", remedy="check its name and folder") from error
    except OSError as error:
        raise CalibrationError(f"cannot be read: {error.strerror or error}") from error


def printable(text: str) -> str:
    """Return a text without control characters, which names in a file may contain and terminals obey."""
    return "".join(character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in text)


def _read_version(file: h5py.File) -> tuple[str, int]:
    stated_format = attribute(file, "format")
    if not (isinstance(stated_format, str) and stated_format in (FORMAT, PRESS_FORMAT)):
        raise CalibrationError("an HDF5 file, but not a calibration", remedy="give a file that `cbsr-qa run` issued")
    version = attribute(file, "schema_version")
    if not isinstance(version, np.integer):
        raise CalibrationError("the schema version is missing or no whole number")
    if version > latest_version(stated_format):
        raise CalibrationError(
            f"written to schema version {version}; this program knows versions up to {latest_version(stated_format)}",
            remedy="update cbsr-qa",
        )
    check_released(stated_format, int(version))
    return stated_format, int(version)


def _entry(path: str, dataset: h5py.Dataset) -> Entry:
    units = attribute(dataset, "units")
    if not isinstance(units, str):
        raise CalibrationError(f"{path} states no units")
    if h5py.check_string_dtype(dataset.dtype) is not None:
        return Entry(units, texts(path, dataset))
    values = np.asarray(dataset[()])
    if values.dtype in (np.float64, np.float32, np.int64):
        return Entry(units, values)
    if values.dtype == np.uint8 and values.max(initial=0) <= 1:
        return Entry(units, values.astype(np.bool_))
    raise CalibrationError(f"{path} is of the type {dataset.dtype}, or holds a value, that no calibration has")


@contextmanager
def _name_file_in_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except RefusedError as error:
        reason = printable(error.reason)
        raise CalibrationError(f"calibration file {path}: {reason}", remedy=error.remedy) from error
