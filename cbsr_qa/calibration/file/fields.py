"""Converts any dataclass to entries and back, by the types of its fields and :class:`~cbsr_qa.domain.kept.Kept`."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.file.content import FLAG, INDEX, PURE, TEXT, Entry, Reading, Value
from cbsr_qa.domain.kept import COLUMNS, Kept, KeptField, group_of, item_of, list_fields
from cbsr_qa.domain.numbers import Array, Indices, Mask

Pairs = tuple[tuple[int, int], ...]
Points = tuple[tuple[float, float], ...]

Entries = dict[str, Entry]
#: Functions that write and read a type that is not one dataset per field; both get the path of its group.
Irregular = tuple[Callable[[Entries, str, Any], None], Callable[[Reading, str], Any]]

_INTEGERS: Final = (int, int | None, Pairs, Indices)
#: Units of fields without one in their name.
_UNITS: Final = {bool: FLAG, Mask: FLAG, Pairs: INDEX, Indices: INDEX, str: TEXT, tuple[str, ...]: TEXT}


class Codec:
    """Writes and reads dataclasses.

    Parameters
    ----------
    irregular : special cases by type.
    """

    def __init__(self, irregular: Mapping[Any, Irregular]) -> None:
        self._irregular = irregular

    def write(self, out: Entries, value: Any, within: str, own: str = PURE) -> None:
        """Write a dataclass under the path of its group; ``own`` are the units of its fields."""
        for field in list_fields(type(value)):
            content, group = getattr(value, field.name), group_of(field.hint)
            path, units = _place(field, within, own)
            if field.kept.not_kept or field.is_left_out(content):
                continue
            if field.hint in self._irregular:
                self._irregular[field.hint][0](out, path, content)
            elif item_of(field.hint):
                self.write_list(out, item_of(field.hint), content, path, units)
            elif group is None:
                turned = field.kept.columns
                out[path + COLUMNS if turned else path] = Entry(
                    units, _encode_value(field, content.T if turned else content)
                )
            elif content is not None:
                self.write(out, content, path, units)

    def write_list(self, out: Entries, of: Any, items: Sequence[Any], within: str, own: str = PURE) -> None:
        """Write dataclasses as a list for every field."""
        for field in list_fields(of):
            path, units = _place(field, within, own)
            contents, group = [getattr(item, field.name) for item in items], group_of(field.hint)
            if group is not None:
                self.write_list(out, group, contents, path, units)
            elif not (field.kept.not_kept or (contents and all(map(field.is_left_out, contents)))):
                out[path] = Entry(units, _encode_value(field, contents))

    def read(self, read: Reading, of: Any, within: str, above: Mapping[str, Any] | None = None) -> Any:
        """Return a dataclass; ``above`` are the fields of the enclosing one."""
        values: dict[str, Any] = {}
        for field in list_fields(of):
            path, group = _place(field, within, PURE)[0], group_of(field.hint)
            known_fields = {**(above or {}), **values, **dict(field.kept.given)}
            if field.kept.from_above:
                values[field.name] = known_fields[field.name]
            elif field.kept.not_kept or (field.is_left_out(field.default) and not read.inside(path)):
                continue
            elif field.hint in self._irregular:
                values[field.name] = self._irregular[field.hint][1](read, path)
            elif item_of(field.hint):
                values[field.name] = tuple(self.read_list(read, item_of(field.hint), path, {}))
            elif group is None:
                values[field.name] = _value(read, field, path)
            elif group is field.hint or read.inside(path):
                values[field.name] = self.read(read, group, path, known_fields)
        return of(**values)

    def read_list(self, read: Reading, of: Any, within: str, above: Mapping[str, Any]) -> Iterator[Any]:
        """Yield dataclasses from the lists of their fields; ``above`` is common to all of them."""
        shared = {field.name: above[field.name] for field in list_fields(of) if field.kept.from_above}
        columns: dict[str, Sequence[Any]] = {}
        for field in list_fields(of):
            path, group = _place(field, within, PURE)[0], group_of(field.hint)
            if group is not None:
                columns[field.name] = list(self.read_list(read, group, path, above))
            elif field.kept.not_kept or (field.is_left_out(field.default) and not read.has(path)):
                continue
            elif field.hint in _LISTS:
                columns[field.name] = _LISTS[field.hint](read, path)
            else:
                columns[field.name] = [field.hint(word) for word in read.texts(path)]
        for row in zip(*columns.values(), strict=True):
            yield of(**shared, **dict(zip(columns, row, strict=True)))


def problems(value: Any, within: str) -> Iterator[str]:
    """Describe invalid numbers of a dataclass, by the limits and axes of its fields."""
    lengths: dict[str, int] = {}
    for field in list_fields(type(value)):
        content, path = getattr(value, field.name), _place(field, within, PURE)[0]
        if is_dataclass(content) and not field.kept.not_kept:
            yield from problems(content, path)
            lengths |= {
                part.name: getattr(content, part.name) for part in list_fields(type(content)) if part.hint is int
            }
        elif content is not None and not field.kept.not_kept:
            if field.kept.limited:
                yield from _list_values_beyond(field.kept, path, np.asarray(content))
            if field.kept.dims:
                yield from _check_shape(field, path, np.shape(content), lengths)


def _list_values_beyond(kept: Kept, path: str, values: NDArray[Any]) -> Iterator[str]:
    least, most = kept.least, kept.most
    if not np.isfinite(values).all():
        yield f"{path} holds a value that is not a finite number"
    elif least and most and not (least <= values.min(initial=most) and values.max(initial=least) <= most):
        found_range = f"{values.item()}" if values.size == 1 else f"{values.min():.3g} to {values.max():.3g}"
        yield f"{path} is {found_range}; {least:g} to {most:g} are allowed"
    elif most is not None and (np.abs(values) > most).any():
        yield f"{path} holds {np.abs(values).max():.3g}; {most:g} is allowed"
    elif least is not None and (values < least).any():
        yield f"{path} is negative somewhere"


def _check_shape(field: KeptField, path: str, shape: tuple[int, ...], lengths: dict[str, int]) -> Iterator[str]:
    """Compare a shape with the known lengths of axes, and add new ones."""
    names = field.kept.dims.split()
    if len(names) != len(shape):
        yield f"{path} has the shape {shape}; ({', '.join(names)}) is expected"
        return
    for name, length in zip(names, shape, strict=True):
        axis = name.lstrip("0123456789")
        times = int(name.removesuffix(axis) or 1)
        expected = times * (lengths.setdefault(axis, length) if axis else 1)
        if length != expected:
            yield f"{path} of {shape} does not fit {expected} {axis or 'columns'}"


def _place(field: KeptField, within: str, own: str) -> tuple[str, str]:
    group = group_of(field.hint) is not None
    default = own if group else TEXT if _is_text(field.hint) else _UNITS.get(field.hint, PURE)
    return field.path(within, group=group), field.units(own, default)


def _is_text(hint: Any) -> bool:
    return hint in (str, tuple[str, ...]) or (isinstance(hint, type) and issubclass(hint, StrEnum))


def _encode_value(field: KeptField, held: Any) -> Value:
    """Return the stored form of one value, or of a list; negative zero becomes zero."""
    if _is_text(field.hint):
        return str(held) if isinstance(held, str) else tuple(map(str, held))
    if field.hint in (bool, Mask):
        return np.array(held, dtype=np.bool_)
    if field.hint in _INTEGERS:
        numbers = [-1 if number is None else number for number in held] if isinstance(held, list) else held
        return np.array(numbers, dtype=np.int64)
    if field.hint == tuple[float, ...]:
        held = _pad_rows(held)
    elif held is None and field.hint != float | None:
        held = ()
    values = np.array(held, dtype=np.float64, order="C")  # None becomes NaN
    values += 0.0
    single = values.astype(np.float32)
    exact = field.kept.shortest and np.array_equal(single.astype(np.float64), values)
    return single if field.kept.single or exact else values


def _pad_rows(rows: Sequence[tuple[float, ...]]) -> Array:
    """Rows of at most two numbers as an (n, 2) array, padded with NaN."""
    table = np.full((len(rows), 2), np.nan)
    for index, row in enumerate(rows):
        table[index, : len(row)] = row
    return table


#: Readers of one value, and of a list.
_VALUES: Final[Mapping[Any, Callable[[Reading, str], Any]]] = {
    str: Reading.text,
    tuple[str, ...]: Reading.texts,
    float: Reading.number,
    float | None: Reading.optional_number,
    tuple[float, float]: Reading.need_pair,
    tuple[float, float] | None: Reading.pair,
    Array: Reading.numbers,
    Array | None: Reading.optional,
    Points: lambda read, path: _rows(read.numbers(path)),
    int: lambda read, path: int(read.array(path, np.int64, ())),
    Indices: lambda read, path: read.array(path, np.int64),
    Pairs: lambda read, path: _rows(read.array(path, np.int64)),
    bool: lambda read, path: bool(read.array(path, np.bool_, ())),
    Mask: lambda read, path: read.array(path, np.bool_),
}
_LISTS: Final[Mapping[Any, Callable[[Reading, str], Sequence[Any]]]] = {
    str: Reading.texts,
    float: lambda read, path: read.numbers(path).tolist(),
    float | None: Reading.optional_numbers,
    tuple[float, ...]: lambda read, path: [tuple(row[~np.isnan(row)].tolist()) for row in read.numbers(path)],
    int: lambda read, path: read.array(path, np.int64).tolist(),
    int | None: lambda read, path: [None if n < 0 else n for n in read.array(path, np.int64).tolist()],
    bool: lambda read, path: read.array(path, np.bool_).tolist(),
}


def _value(read: Reading, field: KeptField, path: str) -> Any:
    if field.kept.columns:
        return np.ascontiguousarray(read.floats(path + COLUMNS).T)
    if field.kept.single or field.kept.shortest:
        return read.array(path, np.float32).astype(np.float64) if field.kept.single else read.floats(path)
    return _VALUES[field.hint](read, path) if field.hint in _VALUES else field.hint(read.text(path))


def _rows(table: NDArray[Any]) -> tuple[tuple[Any, Any], ...]:
    return tuple((first, second) for first, second in table.tolist())
