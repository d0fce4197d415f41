"""A calibration as named, typed values with units, the content of its file in any format, and digests.

``digest`` covers everything. It can be recomputed from the file with h5py and hashlib alone: feed a SHA-256 with the
line ``format TAB schema_version NEWLINE``, format being ``cbsr-qa calibration`` or, if learned from labelled presses,
``cbsr-qa press calibration``, and then, for every dataset in the order of its path (without leading ``/``, sorted by
Unicode code point), with the UTF-8 bytes of the line ``path TAB units TAB kind TAB shape NEWLINE``, where ``kind`` is
``f8``, ``f4``, ``i8``, ``u1`` or ``text`` and ``shape`` the lengths joined by ``x`` (empty for one value), and with
the data in C order: little-endian numbers, or for each text its length in bytes in decimal, a NEWLINE and its UTF-8
bytes.

``record_digest`` is the same digest over the datasets that cannot be recomputed: all but those named by
:data:`PREPARED`. Mesh, model, matrix and the templates of the head follow from sensor type, method, parameter, head,
used readings and their merging, which are covered, and the readings' noise from the run's unloaded frames, but only
to rounding, which depends on the computer. So a calibration rebuilt from a database has the same ``record_digest``
anywhere, and the same ``digest`` if the arithmetic is the same.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import LAST_UNRELEASED, CalibrationError
from cbsr_qa.domain.kept import walk_fields
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.press_calibration import PressCalibration

#: Possible values: float64, float32, int64 or bool arrays of any shape, one text, or a list of texts.
Value = Array | NDArray[np.float32] | Indices | Mask | str | tuple[str, ...]

#: Units of values that have none.
PURE: Final = "1"
TEXT: Final = "text"
INDEX: Final = "index"
FLAG: Final = "flag"


#: Largest number of entries, with the groups that they are in; a calibration of a run has some 200.
MOST_ENTRIES: Final = 2000


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """One value with its unit."""

    units: str
    value: Value


class Reading:
    """Typed access to entries.

    Every method raises CalibrationError, naming the path, if it is missing or of another type.
    """

    def __init__(self, entries: Mapping[str, Entry]) -> None:
        self._entries = entries
        self._within = {path[: end + 1] for path in entries for end, sign in enumerate(path) if sign == "/"}

    def has(self, path: str) -> bool:
        """Return whether there is an entry: not all kinds of sensor have all of them."""
        return path in self._entries

    def number(self, path: str) -> float:
        """Return a finite number."""
        value = float(self.array(path, np.float64, ()))
        if not np.isfinite(value):
            raise CalibrationError(f"{path} is {value:g}; a finite number is expected")
        return value

    def optional_number(self, path: str) -> float | None:
        """Return a number, or None if it is absent."""
        value = float(self.array(path, np.float64, ()))
        return None if np.isnan(value) else self.number(path)

    def numbers(self, path: str) -> Array:
        """Return an array of numbers; none is infinite."""
        array: Array = self.array(path, np.float64)
        if np.isinf(array).any():
            raise CalibrationError(f"{path} holds a number that is infinite; finite ones are expected")
        return array

    def floats(self, path: str) -> Array:
        """Return an array of finite numbers stored in single or double precision."""
        value = self._value(path)
        single = isinstance(value, np.ndarray) and value.dtype == np.float32
        values = self.array(path, np.float32).astype(np.float64) if single else self.numbers(path)
        if not np.isfinite(values).all():
            raise CalibrationError(f"{path} holds a value that is not a finite number")
        return values

    def optional_numbers(self, path: str) -> list[float | None]:
        """Return a list of numbers, None for absent ones."""
        return [None if np.isnan(value) else float(value) for value in self.numbers(path)]

    def optional(self, path: str) -> Array | None:
        """Return an array of numbers, or None if it is empty."""
        values = self.numbers(path)
        return values if values.size else None

    def pair(self, path: str) -> tuple[float, float] | None:
        """Return (lowest, highest), or None if it is empty."""
        values = self.optional(path)
        if values is None:
            return None
        if values.shape != (2,):
            raise CalibrationError(f"{path} holds {values.shape} numbers instead of two")
        if not np.isfinite(values).all():
            raise CalibrationError(f"{path} is {values[0]:g} to {values[1]:g}; finite numbers are expected")
        return float(values[0]), float(values[1])

    def need_pair(self, path: str) -> tuple[float, float]:
        """Return (lowest, highest)."""
        pair = self.pair(path)
        if pair is None:
            raise CalibrationError(f"{path} is empty")
        return pair

    def text(self, path: str) -> str:
        value = self._value(path)
        if not isinstance(value, str):
            raise CalibrationError(f"{path} is not a text")
        return value

    def texts(self, path: str) -> tuple[str, ...]:
        value = self._value(path)
        if not isinstance(value, tuple):
            raise CalibrationError(f"{path} is not a list of texts")
        return value

    def inside(self, path: str) -> bool:
        """Whether there is this entry, or one in this group."""
        return path in self._entries or path in self._within

    def groups(self, path: str) -> tuple[str, ...]:
        """Return the names of the groups directly inside one, sorted."""
        names_inside = (name.removeprefix(f"{path}/") for name in self._entries if name.startswith(f"{path}/"))
        return tuple(sorted({name.split("/")[0] for name in names_inside if "/" in name}))

    def units(self, path: str) -> str:
        self._value(path)
        return self._entries[path].units

    def _value(self, path: str) -> Value:
        if path not in self._entries:
            raise CalibrationError(f"{path} is missing")
        return self._entries[path].value

    def array(self, path: str, kind: type[np.generic], shape: tuple[int, ...] | None = None) -> NDArray[Any]:
        """Return an array of a kind and of a shape, or by default of one axis or more."""
        value = self._value(path)
        if not isinstance(value, np.ndarray) or value.dtype != kind:
            raise CalibrationError(f"{path} does not hold {kind.__name__} numbers")
        if shape is not None and value.shape != shape:
            raise CalibrationError(f"{path} has the shape {value.shape} instead of {shape}")
        if shape is None and not value.ndim:
            raise CalibrationError(f"{path} is one number where several are expected")
        return value


#: Format of a run's calibration, and of one learned from labelled presses.
FORMAT, PRESS_FORMAT = "cbsr-qa calibration", "cbsr-qa press calibration"
#: Entries that only the latter has.
_OF_PRESSES: Final = "readings/pairs"
#: First schema versions that were released; later ones only add entries. They are those that the last program of
#: before 0.1.0 wrote: the version is part of the digest, and so of what is signed.
FIRST_VERSION: Final = {FORMAT: 5, PRESS_FORMAT: 4}

_TABLE: Final = tuple(walk_fields(Calibration))
#: Paths, or prefixes of paths, of entries recomputed from the others.
PREPARED: Final = tuple(path for path, field in _TABLE if field.kept.prepared)
#: Formats' classes.
_KINDS: Final[Mapping[str, type]] = {FORMAT: Calibration, PRESS_FORMAT: PressCalibration}


def format_of(entries: Mapping[str, Entry]) -> str:
    """Return the format of some entries."""
    return PRESS_FORMAT if _OF_PRESSES in entries else FORMAT


def latest_version(format_: str) -> int:
    """Return the latest schema version of a format."""
    return max([FIRST_VERSION[format_], *(since for _, since in _list_added(format_))])


def check_released(format_: str, version: int) -> None:
    """Refuse a file from before version 0.1.0. CalibrationError names the commit that still reads it."""
    if version < FIRST_VERSION[format_]:
        raise CalibrationError(
            f"written to schema version {version}, from before version 0.1.0, which this program does not read",
            remedy=f"issue a new one; commit {LAST_UNRELEASED} of cbsr-qa still reads this one",
        )


def schema_version(entries: Mapping[str, Entry]) -> int:
    """Return the lowest schema version that has all of some entries: earlier calibrations keep their digests."""
    format_ = format_of(entries)
    needed = (since for part, since in _list_added(format_) if any(path.startswith(part) for path in entries))
    return max([FIRST_VERSION[format_], *needed])


def _list_added(format_: str) -> tuple[tuple[str, int], ...]:
    """Return paths, or prefixes of paths, of entries that later versions added, with the version."""
    return tuple(
        (path, field.kept.since) for path, field in walk_fields(_KINDS[format_], lists=True) if field.kept.since
    )


def content_digest(entries: Mapping[str, Entry], version: int | None = None) -> str:
    """Return the SHA-256 of entries as described at the top of this module, in hexadecimal digits."""
    digest = hashlib.sha256(f"{format_of(entries)}\t{version or schema_version(entries)}\n".encode())
    for path in sorted(entries):
        kind, shape, data = _canonical(entries[path].value)
        digest.update(f"{path}\t{entries[path].units}\t{kind}\t{'x'.join(map(str, shape))}\n".encode())
        digest.update(data)
    return digest.hexdigest()


def record_digest(entries: Mapping[str, Entry]) -> str:
    """Return the digest over the entries that are not recomputed."""
    if format_of(entries) == PRESS_FORMAT:
        return content_digest(entries)
    recorded = {path: entry for path, entry in entries.items() if not path.startswith(PREPARED)}
    return content_digest(recorded, schema_version(entries))


def _canonical(value: Value) -> tuple[str, tuple[int, ...], bytes]:
    if isinstance(value, np.ndarray):
        kind = {"f8": "<f8", "f4": "<f4", "i8": "<i8", "b1": "|u1"}[value.dtype.str[1:]]
        return kind[1:], value.shape, value.astype(kind).tobytes()
    texts = [text.encode() for text in ((value,) if isinstance(value, str) else value)]
    shape = () if isinstance(value, str) else (len(texts),)
    return "text", shape, b"".join(b"%d\n%s" % (len(text), text) for text in texts)
