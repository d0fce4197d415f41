"""How the fields of a dataclass are kept in a file, beyond what their names and types imply.

A field is kept as one dataset. Its path is the field's name without its unit, its unit the one the name ends with,
its kind follows from its type: ``radius_mm: float`` is ``radius`` in mm, one float64. A field that is a dataclass is
a group, a tuple of dataclasses a group with a list for every field. ``Annotated[type, Kept(...)]`` states the rest.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from functools import cache
from operator import attrgetter
from types import UnionType
from typing import Any, Final, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

#: Units of a field that has those of its parent.
OWN: Final = "own"
_SUFFIXES: Final = {
    **{unit: unit for unit in ("mm", "s", "A", "N", "kPa", "deg")},
    "C": "degC",
}
#: Ends the path of an array that is kept column by column.
COLUMNS: Final = "_columns"

_Kind = TypeVar("_Kind")


@dataclasses.dataclass(frozen=True, slots=True)
class Kept:
    """How a field is kept.

    Parameters
    ----------
    path : path in its parent's group, or from the root if it begins with ``/``; a group's path ends with ``/``.
    units : units of a value; of a group, those its fields inherit by :data:`OWN`.
    since : version of the file that brought it; 0: every version has it. Earlier files are read with the default,
        which is not written, so that they keep their digests.
    omitted : whether it is left out of the file if it is the default, though every version has it.
    prepared : whether the field follows from the rest of the file.
    single : whether the field is kept in single precision; ``shortest``: if that is lossless.
    steps : number of steps, up to its largest magnitude, to which an array is rounded when issued, see
        :func:`round_to_steps`.
    columns : whether an array in steps is kept by columns, so that equal columns are compressed as one.
    dims : names of the axes, whose lengths agree throughout a dataclass, e.g. ``"n r"``.
    least, most : allowed range; given either, numbers must be finite.
    source : attribute of a run's observation, e.g. ``"settings.size_ratio"``.
    given : fields of a group that follow from its path: (name, value).
    not_kept : a field not in the file, or (``from_above``) one that the parent has as well.
    """

    path: str | None = None
    units: str = ""
    since: int = 0
    omitted: bool = False
    prepared: bool = False
    single: bool = False
    shortest: bool = False
    steps: int = 0
    columns: bool = False
    dims: str = ""
    least: float | None = None
    most: float | None = None
    source: str = ""
    given: tuple[tuple[str, Any], ...] = ()
    not_kept: bool = False
    from_above: bool = False

    @property
    def limited(self) -> bool:
        """Whether its range is limited."""
        return self.least is not None or self.most is not None


NOT_KEPT: Final = Kept(not_kept=True)
FROM_ABOVE: Final = Kept(not_kept=True, from_above=True)


@dataclasses.dataclass(frozen=True, slots=True)
class KeptField:
    """A field of a dataclass: its name, type and default, and how it is kept."""

    name: str
    hint: Any
    default: Any
    kept: Kept

    def path(self, within: str, *, group: bool = False) -> str:
        """Return the path of its dataset or group, given that of its parent group."""
        own_path = self.kept.path
        if own_path is None:
            own_path = self.name.removesuffix(f"_{self._suffix()}") + ("/" if group else "")
        return own_path[1:] if own_path.startswith("/") else within + own_path

    def units(self, of_group: str, default: str) -> str:
        """Return its units, given those of its group."""
        found = self.kept.units or _SUFFIXES.get(self._suffix(), default)
        return of_group if found == OWN else found

    def is_left_out(self, value: object) -> bool:
        """Whether a field that files may lack has its default."""
        optional = self.kept.omitted or self.kept.since > 0
        return optional and (value is self.default or (type(value) is type(self.default) and value == self.default))

    def _suffix(self) -> str:
        end = self.name.rpartition("_")[2]
        return end if end in _SUFFIXES else ""


def list_fields(of: Any) -> tuple[KeptField, ...]:
    """Return the fields of a dataclass."""
    return _read_fields(of)


@cache
def _read_fields(of: Any) -> tuple[KeptField, ...]:
    hints = get_type_hints(of, include_extras=True)
    kept_fields = []
    for field in dataclasses.fields(of):
        hint, annotated = hints[field.name], Kept()
        annotations = [a for a in getattr(hint, "__metadata__", ()) if isinstance(a, Kept)]
        if annotations:
            hint, annotated = hint.__origin__, annotations[0]
        kept_fields.append(KeptField(field.name, hint, field.default, annotated))
    return tuple(kept_fields)


def as_filed(held: _Kind) -> _Kind:
    """Return a dataclass with its arrays in the precision of its file, so that the issued one equals the one read."""
    filed: dict[str, Any] = {}
    for field in list_fields(type(held)):
        if field.kept.not_kept:
            continue
        value = filed_value = getattr(held, field.name)
        if isinstance(value, np.ndarray) and value.dtype == np.float64:
            filed_value = _round_as_filed(value, field.kept)
        elif dataclasses.is_dataclass(value):
            filed_value = as_filed(value)
        if filed_value is not value:
            filed[field.name] = filed_value
    return dataclasses.replace(held, **filed) if filed else held  # type: ignore[type-var]


def _round_as_filed(values: NDArray[np.float64], kept: Kept) -> NDArray[np.float64]:
    """Return values in the precision of a file, without negative zeros; themselves if they are."""
    rounded = round_to_steps(values, kept.steps) if kept.steps else values
    single = rounded.astype(np.float32).astype(np.float64) if kept.single else rounded
    filed: NDArray[np.float64] = single + 0.0
    return values if filed.tobytes() == values.tobytes() else filed


def round_to_steps(values: NDArray[np.float64], steps: int) -> NDArray[np.float64]:
    """Round values to multiples of the largest power of two not above the largest magnitude over ``steps``.

    Rounding twice changes nothing more. Values so small that a step would be no normal number stay as they are.
    """
    largest, step = float(np.abs(values).max(initial=0.0)), 1.0
    if not np.finfo(np.float64).tiny * 2 * steps <= largest < np.inf:
        return values
    for _ in range(2):  # the largest may be rounded up to where steps are twice as large
        step = 2.0 ** np.floor(np.log2(largest / steps))
        largest = float(np.round(largest / step)) * step
    rounded: NDArray[np.float64] = np.round(values / step) * step
    return rounded


def group_of(hint: Any) -> type | None:
    """Return the dataclass of a field, which may be optional; None for other types."""
    types = hint.__args__ if isinstance(hint, UnionType) else (hint,)
    dataclass_types = [
        candidate for candidate in types if isinstance(candidate, type) and dataclasses.is_dataclass(candidate)
    ]
    return dataclass_types[0] if len(dataclass_types) == 1 else None


def item_of(hint: Any) -> Any:
    """Return the dataclass of a list field, or None."""
    item, *other_items = getattr(hint, "__args__", (None,))
    return item if other_items == [...] and dataclasses.is_dataclass(item) else None


def walk_fields(of: type, within: str = "", *, lists: bool = False) -> Iterator[tuple[str, KeptField]]:
    """Yield every field a dataclass keeps, groups before their members; those of listed dataclasses if ``lists``."""
    for field in list_fields(of):
        group = group_of(field.hint)
        if not field.kept.not_kept:
            yield field.path(within, group=group is not None), field
        members = group or (item_of(field.hint) if lists else None)
        if members is not None and not field.kept.not_kept:
            yield from walk_fields(members, field.path(within, group=True), lists=lists)


def take_sources(of: type, holder: Any) -> Mapping[str, Any]:
    """Return the fields of a dataclass that another object has, by their ``source``."""
    sources = {field.name: field.kept.source for field in list_fields(of)}
    return {name: attrgetter(source)(holder) for name, source in sources.items() if source}
