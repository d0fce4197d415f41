"""Conversion of other objects and JSON to dataclasses; equal names hold equal content."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import StrEnum
from functools import cache
from math import isfinite
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")


def fill_from_object(kind: type[T], source: object, /, **rest: Any) -> T:
    """Return a dataclass of the attributes that ``source`` has by the names of its fields; ``rest`` goes first."""
    names = (field.name for field in fields(kind) if field.name not in rest)  # type: ignore[arg-type]
    return kind(**{name: getattr(source, name) for name in names if hasattr(source, name)}, **rest)


def fill_from_mapping(kind: type[T], values: Mapping[str, Any], /, **rest: Any) -> T:
    """Return a dataclass of the values named as its fields, each as :func:`convert_json`; ``rest`` goes first."""
    hints = _read_hints(kind)  # type: ignore[arg-type]  # a class is hashable
    names = hints.keys() & values.keys() - rest.keys()
    converted = {
        name: values[name] if _is_plain(hints[name]) else convert_json(hints[name], values[name]) for name in names
    }
    return kind(**converted, **rest)


def convert_json(hint: Any, value: Any) -> Any:
    """Return JSON as the type of a field: tables as dataclasses, lists as tuples, words as members of enumerations.

    If the type allows several dataclasses, the first that has all keys is used. Numbers and texts are unchanged.

    Raises
    ------
    KeyError, TypeError, ValueError
        If the JSON does not fit the type.
    """
    kinds = get_args(hint) or (hint,)
    if get_origin(hint) is tuple:
        if kinds[-1] is ...:
            return tuple(convert_json(kinds[0], item) for item in (() if value is None else value))
        return tuple(convert_json(kind, item) for kind, item in zip(kinds, value, strict=True))
    if get_origin(hint) in (Union, UnionType):
        if value is None and NoneType in kinds:
            return None
        kinds = tuple(kind for kind in kinds if kind is not NoneType)
        if len(kinds) == 1:
            return convert_json(kinds[0], value)
    tables: list[Any] = [kind for kind in kinds if is_dataclass(kind)]
    if tables:
        if not isinstance(value, Mapping):
            raise TypeError(f"{str(value)[:60]!r} is not a table")
        table = next((candidate for candidate in tables if value.keys() <= _read_hints(candidate).keys()), tables[0])
        return table(**{name: convert_json(_read_hints(table)[name], item) for name, item in value.items()})
    return hint(value) if isinstance(hint, type) and issubclass(hint, StrEnum) else value


def find_odd_value(hint: Any, value: Any, key: str = "") -> str:
    """Say which value of a filled dataclass is not of its type, or not finite: key and value; empty if all are.

    Only for fields that are numbers, texts, dataclasses, tuples, or one of these or None.
    """
    kinds = get_args(hint) or (hint,)
    if get_origin(hint) is tuple:
        every = kinds[:1] * len(value) if kinds[-1] is ... else kinds
        numbered = enumerate(zip(every, value, strict=True))
        parts = [(kind, item, f"{key}[{number}]") for number, (kind, item) in numbered]
    elif get_origin(hint) in (Union, UnionType):
        parts = [] if value is None else [(kinds[0], value, key)]
    elif isinstance(hint, type) and is_dataclass(hint):
        dot = f"{key}." if key else ""
        parts = [(kind, getattr(value, name), f"{dot}{name}") for name, kind in _read_hints(hint).items()]
    else:
        allowed = (int, float) if hint is float else hint
        fits = isinstance(value, allowed) and isinstance(value, bool) is (hint is bool)
        return "" if fits and (hint is not float or isfinite(value)) else f"{key} is {str(value)[:60]!r}"
    return next(filter(None, (find_odd_value(*part) for part in parts)), "")


@cache
def _is_plain(hint: Any) -> bool:
    """Whether values of a type are numbers, texts or None: those of a thousand measurements need no look at it."""
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    return all(kind in (bool, int, float, str, NoneType) for kind in kinds)


@cache
def _read_hints(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}
