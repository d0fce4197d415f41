"""A calibration as JSON and back, without loss, for users without HDF5.

One object with ``format``, ``schema_version``, ``digest`` and ``datasets``: for each path in the HDF5 file its
``units``, ``kind`` (``f8``, ``f4``, ``i8``, ``u1`` or ``text``), ``shape`` and ``values``, flat in C order, or for
large arrays ``base64`` of the little-endian bytes. Missing numbers are null. The digest is that of the HDF5 file, as
the content is the same, and so is the signature: an object with the names of the HDF5 file's attributes.
"""

import base64
import binascii
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.file.content import (
    FORMAT,
    PRESS_FORMAT,
    Entry,
    Value,
    content_digest,
    format_of,
    latest_version,
    record_digest,
    schema_version,
)
from cbsr_qa.calibration.file.entries import Issued, decode, encode
from cbsr_qa.calibration.file.hdf5 import file_bytes, printable
from cbsr_qa.calibration.file.signing import SIGNATURE, read_signature
from cbsr_qa.domain import CalibrationError
from cbsr_qa.domain.results import Signature, VerifiedFile
from cbsr_qa.system import parsed_json

#: Of a document; a file with any other is not what was written.
_KEYS: Final = frozenset({"format", "schema_version", "digest", "signature", "datasets"})
_AS_WRITTEN: Final = "use the file as it was written"
#: Arrays of more values are written as bytes.
_SPELT_OUT: Final = 256
#: Lists, objects and their items; each takes some hundred bytes of memory when parsed.
_MOST_VALUES: Final = 4_000_000
_KINDS: Final[Mapping[str, Any]] = {"f8": np.float64, "f4": np.float32, "i8": np.int64, "u1": np.bool_}


def json_document(calibration: Issued) -> dict[str, Any]:
    """Return a calibration as one JSON document. CalibrationError if it contradicts itself."""
    entries = encode(calibration)
    return {
        "format": format_of(entries),
        "schema_version": schema_version(entries),
        "digest": content_digest(entries),
        **({} if calibration.signature is None else {"signature": asdict(calibration.signature)}),
        "datasets": {path: dataset(entries[path]) for path in sorted(entries)},
    }


def dataset(entry: Entry, *, spelt_out: int = _SPELT_OUT) -> dict[str, Any]:
    """Return one entry; arrays of more than ``spelt_out`` values as bytes."""
    if isinstance(entry.value, str):
        return {"units": entry.units, "kind": "text", "shape": [], "values": [entry.value]}
    if isinstance(entry.value, tuple):
        return {"units": entry.units, "kind": "text", "shape": [len(entry.value)], "values": list(entry.value)}
    kind, values = _kind(entry.value), entry.value
    stated = {"units": entry.units, "kind": kind, "shape": list(values.shape)}
    if values.size > spelt_out or np.isinf(values).any():  # JSON has no infinity
        return {**stated, "base64": base64.b64encode(_bytes(values, kind)).decode()}
    return {**stated, "values": [_number(value) for value in values.ravel().tolist()]}


def read_json_calibration(path: Path) -> Issued:
    """Read a calibration from JSON whose digest and schema are sound.

    Raises
    ------
    CalibrationError
        If it does not exist, is not a calibration in JSON, edited since it was written, or of a later version.
    """
    with _naming(path):
        entries, digest, signature = _read(path)
        return replace(decode(entries), digest=digest, record_digest=record_digest(entries), signature=signature)


def verify_json_calibration(path: Path) -> VerifiedFile:
    """Check digest and schema of a calibration in JSON; refused as by :func:`read_json_calibration`."""
    with _naming(path):
        entries, digest, signature = _read(path)
        decode(entries)
        version = schema_version(entries)
        return VerifiedFile(path, version, digest, record_digest(entries), len(entries), False, signature)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    try:
        yield
    except CalibrationError as error:
        raise CalibrationError(f"calibration {path}: {printable(error.reason)}", remedy=error.remedy) from error


def _read(path: Path) -> tuple[dict[str, Entry], str, Signature | None]:
    document = _document(path)
    format_ = document.get("format")
    if format_ not in (FORMAT, PRESS_FORMAT) or not isinstance(document.get("datasets"), dict):
        raise CalibrationError(
            "JSON, but not a whole calibration",
            remedy="give what `cbsr-qa calibration export` wrote, without --firmware",
        )
    if unknown := document.keys() - _KEYS:
        raise CalibrationError(f"no calibration has the key {min(unknown)!r}", remedy=_AS_WRITTEN)
    version = document.get("schema_version")
    if not isinstance(version, int) or not 1 <= version <= latest_version(format_):
        raise CalibrationError(
            f"written to schema version {version!r}; this program knows versions up to {latest_version(format_)}",
            remedy="update cbsr-qa",
        )
    entries = {name: _entry(name, stated) for name, stated in document["datasets"].items()}
    digest = content_digest(entries, version)
    if digest != document.get("digest") or format_ != format_of(entries) or version != schema_version(entries):
        raise CalibrationError(
            f"the content was changed after it was written: its SHA-256 is {digest}",
            remedy=f"{_AS_WRITTEN}; a sensor's values are changed by calibrating it again",
        )
    return entries, digest, _signature(document)


def _signature(document: dict[str, Any]) -> Signature | None:
    if "signature" not in document:
        return None
    stated = document["signature"]
    if not isinstance(stated, dict) or set(stated) - set(SIGNATURE) or not stated:
        raise CalibrationError("its signature is damaged: it has other parts than a signature", remedy=_AS_WRITTEN)
    return read_signature(stated)


def _document(path: Path) -> dict[str, Any]:
    data = file_bytes(path)
    if sum(map(data.count, (b",", b"[", b"{"))) > _MOST_VALUES:
        raise CalibrationError(f"JSON of more than {_MOST_VALUES} values: too many for a calibration")
    try:
        document = parsed_json(data)
    except ValueError as error:
        raise CalibrationError(f"not JSON: {error}", remedy="copy it again from where it was written") from error
    return document if isinstance(document, dict) else {}


def _entry(path: str, stated: object) -> Entry:
    try:
        if not isinstance(stated, dict):
            raise CalibrationError(f"{path} is not a dataset")
        units, kind, shape = stated["units"], stated["kind"], tuple(stated["shape"])
        if not (isinstance(units, str) and all(type(n) is int and n >= 0 for n in shape)):
            raise CalibrationError(f"{path} states no units or no shape")
        f"{path}{units}".encode()  # JSON can encode lone surrogates, which are not text
        return Entry(units, _texts(stated, shape) if kind == "text" else _array(stated, _KINDS[kind], kind, shape))
    except (KeyError, TypeError, ValueError, OverflowError, binascii.Error) as error:
        raise CalibrationError(f"{path} is not a dataset of a calibration: {error}") from error


def _texts(stated: dict[str, Any], shape: tuple[int, ...]) -> Value:
    texts = stated["values"]
    if not all(isinstance(text, str) for text in texts) or shape not in ((), (len(texts),)):
        raise ValueError("a text is expected")
    "".join(texts).encode()
    if not shape:
        (text,) = texts
        return str(text)
    return tuple(texts)


def _array(stated: dict[str, Any], kind: Any, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
    if "base64" in stated:
        held = np.frombuffer(base64.b64decode(stated["base64"], validate=True), dtype=f"<{name}")
    else:
        numbers = [np.nan if value is None else value for value in stated["values"]]
        held = np.array(numbers, dtype=np.int64 if name in ("i8", "u1") else np.float64)
        if name in ("i8", "u1") and any(type(value) is not int for value in numbers):
            raise ValueError("whole numbers are expected")
    if name == "u1" and held.max(initial=0) > 1:
        raise ValueError("0 or 1 is expected")
    return held.astype(kind).reshape(shape)


def _kind(values: NDArray[Any]) -> str:
    return "u1" if values.dtype == np.bool_ else str(values.dtype.str[1:])


def _bytes(values: NDArray[Any], kind: str) -> bytes:
    return values.astype(f"<{kind}" if kind != "u1" else "u1").tobytes()


def _number(value: float | int | bool) -> float | int | None:
    if isinstance(value, bool):
        return int(value)
    return None if isinstance(value, float) and np.isnan(value) else value
