"""Validated entries of a recording file: presence, kind, type, shape, length.

Whoever wrote the file may have put anything under any name. Refusals name the entry, what was found and what is
expected; whoever opened the file puts its name before them.
"""

import json
import math
from dataclasses import fields
from typing import Any, Final, NoReturn

import h5py
import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.file import attribute
from cbsr_qa.domain import RefusedError
from cbsr_qa.domain.sensor import ElectrodeKind, ElectrodeLayout, Electrodes, PlacedElectrodes
from cbsr_qa.plugin import echo, printable

#: Characters of one text: names have some tens, notes some hundreds.
_LONGEST_TEXT: Final = 1000
_LONGEST_NOTE: Final = 2**14
_LONGEST_JSON: Final = 2**24
_MOST_ELECTRODES: Final = 4096


def group_of(parent: h5py.Group, name: str) -> h5py.Group:
    """Return a group. RefusedError if it is missing, or a dataset."""
    found = _member(parent, name)
    if not isinstance(found, h5py.Group):
        raise RefusedError(f"{found.name} is a dataset; a group is expected")
    return found


def numbers(
    parent: h5py.Group, name: str, kinds: str = "iuf", shape: tuple[int, ...] | None = None
) -> NDArray[np.float64]:
    """Read a dataset of real numbers as float64.

    Parameters
    ----------
    kinds : numpy's letters of the types it may have.
    shape : the one it must have; None for any.

    Raises
    ------
    RefusedError
        If it is missing, a group, or of another type or shape.
    """
    dataset = _dataset(parent, name)
    if dataset.dtype.kind not in kinds:
        remedy = "readings of alternating current are out of scope" if dataset.dtype.kind == "c" else ""
        expected = "real numbers" if "f" in kinds else "whole numbers"
        raise RefusedError(f"{dataset.name} holds values of type {dataset.dtype}, not {expected}", remedy=remedy)
    if shape is not None and dataset.shape != shape:
        raise RefusedError(f"{dataset.name} has shape {dataset.shape}; {shape} is expected")
    values: NDArray[np.float64] = dataset[()].astype(np.float64)
    return values


def unit_of(parent: h5py.Group, name: str) -> str:
    """Return the unit of a dataset."""
    return text_of(_dataset(parent, name), "unit")


def text_of(item: h5py.Group | h5py.Dataset, name: str, longest: int = _LONGEST_TEXT) -> str:
    """Return a string attribute. RefusedError if it is missing, of another type or too long."""
    value = attribute(item, name)
    if not isinstance(value, str):
        raise RefusedError(f"attribute {name} of {item.name} is missing or is not a single UTF-8 string")
    return _text(f"attribute {name} of {item.name}", value, longest)


def real_of(item: h5py.Group, name: str, what: str) -> float | None:
    """Return an attribute that is one finite real number; None if it is missing.

    Parameters
    ----------
    what : how messages name it.

    Raises
    ------
    RefusedError
        If it is anything else: a text, a list, a complex number, true or false.
    """
    if name not in item.attrs:
        return None
    value = attribute(item, name)
    if not isinstance(value, np.integer | np.floating) or not np.isfinite(value):
        said = item.attrs.get_id(name).dtype if value is None else printable(str(value))
        raise RefusedError(f"{what} ({name} of {item.name}) is {said}; one finite real number is expected")
    return float(value)


def json_of(item: h5py.Group, name: str) -> Any:
    """Return the JSON value of an attribute. RefusedError if invalid, or with NaN or lone surrogates."""
    text = text_of(item, name, _LONGEST_JSON)
    try:
        said = json.loads(text, parse_constant=_no_constant)
        json.dumps(said, ensure_ascii=False).encode()  # JSON can spell halves of characters, which are no text
    except (ValueError, RecursionError) as error:
        raise RefusedError(f"attribute {name} of {item.name} is not JSON") from error
    return said


def _no_constant(name: str) -> NoReturn:
    raise ValueError(name)


class Described:
    """An object of a file's JSON; every value is validated when read.

    Parameters
    ----------
    said : as parsed.
    where : how messages name it.
    """

    def __init__(self, said: Any, where: str) -> None:
        if not isinstance(said, dict):
            raise RefusedError(f"{where} is {_kind(said)}; an object is expected")
        self._said, self._where = said, where

    def __contains__(self, key: str) -> bool:
        return key in self._said

    def text(self, key: str) -> str:
        """A string."""
        return _text(f"{self._where}.{key}", self._take(key, str, "a text"))

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of strings."""
        return texts(f"{self._where}.{key}", self._take(key, list, "a list of strings"))

    def flag(self, key: str) -> bool:
        """A boolean."""
        return bool(self._take(key, bool, "true or false"))

    def whole(self, key: str, most: int) -> int:
        """A whole number of at least 0."""
        value = self._take(key, int, "a whole number")
        if not 0 <= value <= most:
            raise RefusedError(f"{self._where}.{key} is {_kind(value)}; 0 to {most} are allowed")
        return int(value)

    def real(self, key: str) -> float:
        """A finite number."""
        return _real(f"{self._where}.{key}", self._take(key, (int, float), "a number"))

    def absent(self, key: str) -> bool:
        """Whether an optional value is null."""
        return self._take(key, object, "a value") is None

    def within(self, key: str) -> "Described":
        """A nested object."""
        return Described(self._take(key, dict, "an object"), f"{self._where}.{key}")

    def layout(self) -> Electrodes:
        """The object as a layout of electrodes."""
        kind = self.text("kind")
        if kind not in set(ElectrodeKind):
            raise RefusedError(f"{self._where}.kind is {echo(kind)}; allowed: {', '.join(ElectrodeKind)}")
        if "places_mm" in self:
            return PlacedElectrodes(ElectrodeKind(kind), self._places("places_mm"), self.real("width_mm"))
        known = {field.name for field in fields(ElectrodeLayout)}
        if unknown := sorted(set(self._said) - known):
            raise RefusedError(f"{self._where}.{echo(unknown[0])} is unknown; allowed: {', '.join(sorted(known))}")
        return ElectrodeLayout(
            self.whole("count", _MOST_ELECTRODES),
            ElectrodeKind(kind),
            self.real("ring_radius_mm"),
            self.real("width_mm"),
            self.real("first_angle_deg"),
            self.flag("counterclockwise"),
        )

    def _places(self, key: str) -> tuple[tuple[float, float], ...]:
        where, found = f"{self._where}.{key}", []
        for place in self._take(key, list, "a list of places"):
            if not isinstance(place, list) or len(place) != 2:
                raise RefusedError(f"{where} holds {echo(str(place))}; pairs of numbers are expected")
            found.append((_real(where, place[0]), _real(where, place[1])))
        return tuple(found[: _MOST_ELECTRODES + 1])

    def _take(self, key: str, kind: Any, expected: str) -> Any:
        if key not in self._said:
            raise RefusedError(f"{self._where}.{key} is missing")
        value = self._said[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind not in (bool, object)):
            raise RefusedError(f"{self._where}.{key} is {_kind(value)}; {expected} is expected")
        return value


def texts(where: str, said: Any) -> tuple[str, ...]:
    """Validate a list of strings, and return it."""
    if not isinstance(said, list) or not all(isinstance(one, str) for one in said):
        raise RefusedError(f"{where} is not a list of strings")
    return tuple(_text(where, one, _LONGEST_NOTE) for one in said)


def _text(where: str, value: str, longest: int = _LONGEST_TEXT) -> str:
    if len(value) > longest:
        raise RefusedError(f"{where} has {len(value)} characters; at most {longest} are allowed")
    return value


def _real(where: str, value: Any) -> float:
    real = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300
    if not real or not math.isfinite(value):
        raise RefusedError(f"{where} is {_kind(value)}; a finite number is expected")
    return float(value)


def _kind(value: Any) -> str:
    """Describe a value for a message."""
    if isinstance(value, str):
        return echo(value)
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    return json.dumps(value)[:60]


def _dataset(parent: h5py.Group, name: str) -> h5py.Dataset:
    found = _member(parent, name)
    if not isinstance(found, h5py.Dataset):
        raise RefusedError(f"{found.name} is a group; a dataset is expected")
    return found


def _member(parent: h5py.Group, name: str) -> h5py.Group | h5py.Dataset:
    if name not in parent:
        raise RefusedError(f"{name} is missing in {parent.name}")
    return parent[name]
