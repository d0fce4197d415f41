"""Conversion of a calibration to JSON and back, without loss, for users without HDF5.

One object with ``format``, ``schema_version``, ``digest`` and ``datasets``: for each path in the HDF5 file its
``units``, ``kind`` (``f8``, ``f4``, ``i8``, ``u1`` or ``text``), ``shape`` and ``values``, flat in C order, or for
large arrays ``base64`` of the little-endian bytes. Missing numbers are null. The digest is that of the HDF5 file, as
the content is the same, and so is the signature: an object with the names of the HDF5 file's attributes.
"""

import base64
import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.file.content import (
    FIRST_VERSION,
    FORMAT,
    MOST_ENTRIES,
    PRESS_FORMAT,
    TEXT,
    Entry,
    Value,
    check_released,
    content_digest,
    format_of,
    latest_version,
    record_digest,
    schema_version,
)
from cbsr_qa.calibration.file.entries import Issued, decode, encode
from cbsr_qa.calibration.file.hdf5 import file_bytes, printable
from cbsr_qa.calibration.file.hdf5_content import DEEPEST
from cbsr_qa.calibration.file.signing import SIGNATURE, read_signature
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.results.calibration import VerifiedFile
from cbsr_qa.domain.results.signature import Signature
from cbsr_qa.system.json_text import parse_json

#: Keys of a document; a file with any other key is not what was written.
_KEYS: Final = frozenset({"format", "schema_version", "digest", "signature", "datasets"})
_DATASET_KEYS: Final = frozenset({"units", "kind", "shape"})
#: Largest number of dimensions of an array: numpy has no more.
_MAX_AXES: Final = 32
_MAX_QUOTE_LENGTH: Final = 60
_AS_WRITTEN: Final = "use the file as it was written"
#: Largest number of values that are written as text; larger arrays are written as bytes.
_SPELT_OUT: Final = 256
#: Largest number of lists, objects and their items; each takes some hundred bytes of memory when parsed. Of a run, a
#: calibration has five thousand, and one of 20 000 presses whose labels were left out some sixty thousand.
_MAX_VALUES: Final = 250_000
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
    values = entry.value.astype("u1") if entry.value.dtype == np.bool_ else entry.value
    kind = str(values.dtype.str[1:])
    described = {"units": entry.units, "kind": kind, "shape": list(values.shape)}
    if values.size > spelt_out or np.isinf(values).any():  # JSON has no infinity
        return {**described, "base64": base64.b64encode(values.astype(f"<{kind}").tobytes()).decode()}
    numbers = values.ravel().tolist()  # JSON has no NaN
    return {
        **described,
        "values": [None if isinstance(value, float) and np.isnan(value) else value for value in numbers],
    }


def read_json_calibration(path: Path) -> Issued:
    """Read a calibration from JSON whose digest and schema are sound.

    Raises
    ------
    CalibrationError
        If it does not exist, is not a calibration in JSON, edited since it was written, or of a later version.
    """
    with _name_file_in_errors(path):
        entries, digest, signature = _read(path)
        return replace(decode(entries), digest=digest, record_digest=record_digest(entries), signature=signature)


def verify_json_calibration(path: Path) -> VerifiedFile:
    """Check digest and schema of a calibration in JSON; refused as by :func:`read_json_calibration`."""
    with _name_file_in_errors(path):
        entries, digest, signature = _read(path)
        decode(entries)
        version = schema_version(entries)
        return VerifiedFile(path, version, digest, record_digest(entries), len(entries), False, signature)


@contextmanager
def _name_file_in_errors(path: Path) -> Iterator[None]:
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
    first_version, latest = FIRST_VERSION[format_], latest_version(format_)
    if type(version) is int:
        check_released(format_, version)
    if type(version) is not int or version > latest:
        known_versions = (
            f"version {first_version}" if first_version == latest else f"versions {first_version} to {latest}"
        )
        raise CalibrationError(
            f"schema_version is {_quote(version)}; this program knows {known_versions}",
            remedy="update cbsr-qa, if a later one wrote the file",
        )
    if len(document["datasets"]) > MOST_ENTRIES:
        raise CalibrationError(f"more than {MOST_ENTRIES} datasets: no calibration has so many")
    entries = {name: _entry(name, content) for name, content in document["datasets"].items()}
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
    parts = document["signature"]
    if not isinstance(parts, dict) or set(parts) - set(SIGNATURE) or not parts:
        raise CalibrationError("its signature is damaged: it has other parts than a signature", remedy=_AS_WRITTEN)
    return read_signature(parts)


def _document(path: Path) -> dict[str, Any]:
    data = file_bytes(path)
    if sum(map(data.count, (b",", b"[", b"{"))) > _MAX_VALUES:
        raise CalibrationError(f"JSON of more than {_MAX_VALUES} values: too many for a calibration")
    try:
        document = parse_json(data)
    except ValueError as error:
        raise CalibrationError(f"not JSON: {error}", remedy="copy it again from where it was written") from error
    return document if isinstance(document, dict) else {}


def _entry(path: str, stated: object) -> Entry:
    """Return one dataset. CalibrationError, naming path and key, for any value that is not of the exact type."""
    if path.count("/") > DEEPEST or not path.isprintable():
        raise CalibrationError(f"{path[:_MAX_QUOTE_LENGTH]!r} is not a name of a dataset", remedy=_AS_WRITTEN)
    if not isinstance(stated, dict):
        raise CalibrationError(f"{path} is {_quote(stated)}, not a dataset")
    value_keys = {"values", "base64"} & stated.keys()
    if len(value_keys) != 1 or stated.keys() - value_keys != _DATASET_KEYS:
        keys = ", ".join(sorted(stated)) or "none"
        raise CalibrationError(
            f"{path} is not a dataset: it has the keys {keys}; kind, shape, units and either values or base64 are"
            " allowed"
        )
    units, kind, shape = stated["units"], stated["kind"], stated["shape"]
    _require(isinstance(units, str), path, "units", units, "a text")
    _require(
        isinstance(kind, str) and (kind in _KINDS or kind == TEXT), path, "kind", kind, ", ".join([*_KINDS, TEXT])
    )
    is_shape = isinstance(shape, list) and all(type(length) is int and length >= 0 for length in shape)
    _require(is_shape and len(shape) <= _MAX_AXES, path, "shape", shape, "a list of whole numbers from 0 on")
    try:
        f"{path}{units}".encode()  # JSON can encode lone surrogates, which are not text
        return Entry(units, _texts(path, stated, shape) if kind == TEXT else _array(path, stated, kind, shape))
    except (ValueError, OverflowError) as error:
        raise CalibrationError(f"{path} is not a dataset of a calibration: {error}") from error


def _require(allowed: bool, path: str, key: str, found: object, what: str) -> None:
    if not allowed:
        raise CalibrationError(f"{path}: {key} is {_quote(found)}; allowed: {what}", remedy=_AS_WRITTEN)


def _quote(value: object) -> str:
    """Return what a value of JSON is, as JSON writes it or in words."""
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    text = json.dumps(value)
    return text if len(text) <= _MAX_QUOTE_LENGTH else f"{text[:_MAX_QUOTE_LENGTH]}…"


def _texts(path: str, stated: dict[str, Any], shape: list[int]) -> Value:
    texts = _values(path, stated, (str,), "a text")
    count = len(texts)
    _require(shape == [count] or (not shape and count == 1), path, "shape", shape, f"that of {count} texts")
    "".join(texts).encode()
    return tuple(texts) if shape else str(texts[0])


def _values(path: str, stated: dict[str, Any], kinds: tuple[type, ...], what: str) -> list[Any]:
    """Return the values of a dataset, each exactly of one of some types: to Python, True is a whole number."""
    values = stated.get("values")
    _require(isinstance(values, list), path, "values" if "values" in stated else "base64", values, "a list of values")
    assert isinstance(values, list)
    if not {type(value) for value in values} <= set(kinds):
        number, wrong_value = next((n, value) for n, value in enumerate(values) if type(value) not in kinds)
        _require(False, path, f"values[{number}]", wrong_value, what)
    return values


def _array(path: str, stated: dict[str, Any], kind: str, shape: list[int]) -> NDArray[Any]:
    is_whole = kind in ("i8", "u1")
    if "base64" in stated:
        _require(isinstance(stated["base64"], str), path, "base64", stated["base64"], "a text")
        array = np.frombuffer(base64.b64decode(stated["base64"], validate=True), dtype=f"<{kind}")
    elif is_whole:
        array = np.array(_values(path, stated, (int,), "a whole number"), dtype=np.int64)
    else:
        numbers = _values(path, stated, (int, float, type(None)), "a number or null")
        array = np.array([np.nan if value is None else value for value in numbers], dtype=np.float64)
    if kind == "u1" and array.size and not 0 <= array.min() <= array.max() <= 1:
        wrong_value = int(array[(array < 0) | (array > 1)][0])
        _require(False, path, "values", wrong_value, "0 and 1")
    _require(math.prod(shape) == array.size, path, "shape", shape, f"one of {array.size} values")
    return array.astype(_KINDS[kind]).reshape(shape)
