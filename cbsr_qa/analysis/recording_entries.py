"""Validated entries of a recording file: presence, kind, type, shape, length.

A file may contain anything under any name. Refusals name the entry, what was found and what is expected; the caller
adds the name of the file.
"""

import json
from typing import Annotated, Any, Final, Literal, TypeVar

import h5py
import numpy as np
from pydantic import ConfigDict, Field

from cbsr_qa.calibration.file.hdf5_content import attribute
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout, Electrodes, PlacedElectrodes
from cbsr_qa.plugin.problems import CheckedTable, check
from cbsr_qa.system.json_text import parse_json
from cbsr_qa.system.words import printable, quote_value

#: Most characters of a text: names have some tens, notes some hundreds.
_LONGEST_TEXT: Final = 1000
_LONGEST_NOTE: Final = 2**14
_LONGEST_JSON: Final = 2**24
_MOST_ELECTRODES: Final = 4096

_Note = Annotated[str, Field(max_length=_LONGEST_NOTE)]


def group_of(parent: h5py.Group, name: str) -> h5py.Group:
    """Return a group. Raise RefusedError if it is missing, or a dataset."""
    member = _member(parent, name)
    if not isinstance(member, h5py.Group):
        raise RefusedError(f"{member.name} is a dataset; a group is expected")
    return member


def numbers(parent: h5py.Group, name: str, kinds: str = "iuf", shape: tuple[int, ...] | None = None) -> Array:
    """Read a dataset of real numbers as float64.

    Parameters
    ----------
    kinds : numpy's letters of the allowed types.
    shape : required shape; None for any.
    """
    dataset = _dataset(parent, name)
    if dataset.dtype.kind not in kinds:
        remedy = "readings of alternating current are out of scope" if dataset.dtype.kind == "c" else ""
        expected = "real numbers" if "f" in kinds else "whole numbers"
        raise RefusedError(f"{dataset.name} holds values of type {dataset.dtype}, not {expected}", remedy=remedy)
    if shape is not None and dataset.shape != shape:
        raise RefusedError(f"{dataset.name} has shape {dataset.shape}; {shape} is expected")
    values: Array = dataset[()].astype(np.float64)
    return values


def unit_of(parent: h5py.Group, name: str) -> str:
    """Return the unit of a dataset."""
    return text_of(_dataset(parent, name), "unit")


def text_of(item: h5py.Group | h5py.Dataset, name: str, longest: int = _LONGEST_TEXT) -> str:
    """Return a string attribute. Raise RefusedError if it is missing, of another type or too long."""
    value = attribute(item, name)
    if not isinstance(value, str):
        raise RefusedError(f"attribute {name} of {item.name} is missing or is not a single UTF-8 string")
    return _text(f"attribute {name} of {item.name}", value, longest)


def real_of(item: h5py.Group, name: str, what: str) -> float | None:
    """Return an attribute that is one finite real number; None if it is missing.

    Parameters
    ----------
    what : name in messages.
    """
    if name not in item.attrs:
        return None
    value = attribute(item, name)
    if not isinstance(value, np.integer | np.floating) or not np.isfinite(value):
        what_it_is = item.attrs.get_id(name).dtype if value is None else printable(str(value))
        raise RefusedError(f"{what} ({name} of {item.name}) is {what_it_is}; one finite real number is expected")
    return float(value)


def json_of(item: h5py.Group, name: str) -> Any:
    """Return the JSON value of an attribute. Raise RefusedError if invalid, or with NaN or lone surrogates."""
    text = text_of(item, name, _LONGEST_JSON)
    try:
        value = parse_json(text)
        json.dumps(value, ensure_ascii=False).encode()  # JSON can encode lone surrogates, which are not text
    except ValueError as error:
        raise RefusedError(f"attribute {name} of {item.name} is not JSON: {error}") from error
    return value


_Kind = Literal["pin", "arc"]
_Length = Annotated[float, Field(gt=-1e300, lt=1e300)]


class _Ring(CheckedTable):
    count: Annotated[int, Field(ge=0, le=_MOST_ELECTRODES)]
    kind: _Kind
    ring_radius_mm: _Length
    width_mm: _Length
    first_angle_deg: _Length
    counterclockwise: bool


class _Places(CheckedTable):
    kind: _Kind
    places_mm: list[Annotated[list[_Length], Field(min_length=2, max_length=2)]]
    width_mm: _Length


class Description(CheckedTable):
    """The attribute ``description`` of a recording file; keys of later versions are ignored."""

    model_config = ConfigDict(extra="ignore")

    dataset: Annotated[str, Field(max_length=_LONGEST_TEXT)]
    scan: Literal["full", "driven_pairs"]
    still: bool
    magnitudes_only: bool
    clock: Annotated[str, Field(max_length=_LONGEST_TEXT)]
    sensor_type: Annotated[str, Field(max_length=_LONGEST_TEXT)] | None
    layout: dict[str, Any] | None
    notes: list[_Note]
    simulated: list[_Note] | None = None
    serial: Annotated[str, Field(max_length=_LONGEST_TEXT)] | None = None
    frames_dropped: Annotated[int, Field(ge=0, le=2**53)] = 0

    def electrodes(self) -> Electrodes | None:
        """The layout of electrodes. Raise RefusedError if a key is missing, unknown or not allowed."""
        if self.layout is None:
            return None
        if "places_mm" in self.layout:
            layout = validate_entry(_Places, self.layout, "description.layout")
            places_mm = tuple((x, y) for x, y in layout.places_mm[: _MOST_ELECTRODES + 1])
            return PlacedElectrodes(ElectrodeKind(layout.kind), places_mm, layout.width_mm)
        ring = validate_entry(_Ring, self.layout, "description.layout")
        return ElectrodeLayout(**{**ring.model_dump(), "kind": ElectrodeKind(ring.kind)})


_Checked = TypeVar("_Checked", bound=CheckedTable)


def validate_entry(model: type[_Checked], value: Any, where: str) -> _Checked:
    """Validate an object of a file's JSON. RefusedError names the first wrong key, its value and what is allowed."""
    if not isinstance(value, dict):
        raise RefusedError(f"{where} is {quote_value(value)}; an object is expected")
    table, problems = check(model, value)
    if problems or table is None:
        raise RefusedError(f"{where}.{problems[0]}")
    return table


def texts(where: str, value: Any) -> tuple[str, ...]:
    """Validate a list of strings, and return it."""
    if not isinstance(value, list) or not all(isinstance(text, str) for text in value):
        raise RefusedError(f"{where} is not a list of strings")
    return tuple(_text(where, text, _LONGEST_NOTE) for text in value)


def _text(where: str, value: str, longest: int = _LONGEST_TEXT) -> str:
    if len(value) > longest:
        raise RefusedError(f"{where} has {len(value)} characters; at most {longest} are allowed")
    return value


def _dataset(parent: h5py.Group, name: str) -> h5py.Dataset:
    member = _member(parent, name)
    if not isinstance(member, h5py.Dataset):
        raise RefusedError(f"{member.name} is a group; a dataset is expected")
    return member


def _member(parent: h5py.Group, name: str) -> h5py.Group | h5py.Dataset:
    if name not in parent:
        raise RefusedError(f"{name} is missing in {parent.name}")
    return parent[name]
