"""Problems of a table from a file: where, what was found, and what is allowed.

The same sentences serve configuration files and the options of plugins.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from cbsr_qa.system.words import KeyPath, format_key_path, quote_value

#: Terms of pydantic → terms of TOML.
_IN_TOML: Final = {
    "a valid dictionary": "a table",
    "a valid list": "an array",
    "a valid tuple": "an array",
    "a valid string": "text in quotes",
    "a valid number": "a number",
    "a valid integer": "a whole number",
    "a valid boolean": "true or false",
}
_WORDS: Final[Mapping[Any, str]] = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
#: Errors of pydantic that :func:`describe_allowed` words.
_OURS: Final = (
    "greater_than",
    "less_than",
    "float_",
    "int_",
    "finite_number",
    "bool_",
    "literal_error",
    "tuple_type",
)


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with a table: where, what was found, and what is allowed."""

    path: KeyPath
    what: str
    allowed: str = ""

    def __str__(self) -> str:
        found = f"{format_key_path(self.path)} {self.what}".strip()
        return f"{found}; {self.allowed}" if self.allowed else found


class Table(BaseModel):
    """A table of which every key is known."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class CheckedTable(Table):
    """A table whose keys must fit each other as well."""

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong between keys that are right by themselves."""
        yield from ()


Checked = TypeVar("Checked", bound=CheckedTable)


def check(model: type[Checked], data: Mapping[str, Any]) -> tuple[Checked | None, list[Problem]]:
    """Check a table against its model, as far as one mistake does not hide another.

    Returns
    -------
    The table, None where a key that it needs is missing or wrong, and everything that is wrong with it.
    """
    try:
        table: Checked | None = model.model_validate(data)
        problems: list[Problem] = []
    except ValidationError as error:
        worded = [_word_problem(model, detail) for detail in error.errors()]
        within = _above(worded)
        problems = [p for p in worded if p.path not in within]  # an array with a wrong entry is not too short besides
        table = _parse_rest(model, data, [problem.path for problem in problems])
    if table is not None:
        # A key that is left out because it is wrong may be what a table lacks.
        wrong = _above(problems) | {problem.path for problem in problems}
        problems += [problem for problem in table.problems() if problem.path not in wrong]
    return table, problems


def _above(problems: Sequence[Problem]) -> set[KeyPath]:
    """Paths of all tables and arrays around what is wrong."""
    return {problem.path[:depth] for problem in problems for depth in range(len(problem.path))}


def _parse_rest(model: type[Checked], data: Mapping[str, Any], wrong: Sequence[KeyPath]) -> Checked | None:
    """Parse again without the keys that are wrong, so that one of them does not hide what else does not fit."""
    rest: Any = _copy(data)
    for path in wrong:
        names = [depth for depth, part in enumerate(path) if isinstance(part, str)]
        if names:
            place = rest
            for part in path[: names[-1]]:
                place = place.get(part, {}) if isinstance(place, dict) else place[part]
            place.pop(path[names[-1]], None)
    try:
        return model.model_validate(rest)
    except ValidationError:
        return None


def _copy(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {key: _copy(value) for key, value in data.items()}
    return [_copy(value) for value in data] if isinstance(data, list) else data


def _word_problem(model: type[BaseModel], detail: ErrorDetails) -> Problem:
    path: KeyPath = tuple(part for part in detail["loc"] if part != "[key]")  # a key itself is wrong
    found = detail["input"]
    match detail["type"]:
        case "extra_forbidden":
            return Problem(path, *_unknown(str(path[-1]), _table(_field_at(model, path[:-1]))))
        case "missing" if isinstance(path[-1], int):  # an entry of a pair
            path, kind = path[:-1], "too_short"
            return Problem(path, f"is {quote_value(found)}", f"it must be {describe_allowed(_field_at(model, path))}")
        case "missing":
            return Problem(path, "is missing", _missing(str(path[-1]), _table(_field_at(model, path[:-1])), found))
        case "value_error":
            return Problem(path, f"is {quote_value(found)}", str(detail["ctx"]["error"]))
        case kind:
            return Problem(path, f"is {quote_value(found)}", _rule(_field_at(model, path), kind, detail["msg"]))


def _rule(field: Any, kind: str, message: str) -> str:
    """Describe what is allowed: by the field's type and bounds, else in pydantic's words."""
    if isinstance(field, FieldInfo) and field.description:
        return f"it must be {field.description}"
    if field is not None and kind.startswith(_OURS):
        words = describe_allowed(field)
        return f"it must be {words.replace('a number', 'a finite number', 1) if kind == 'finite_number' else words}"
    _, should, rest = message.partition(" should ")
    if not should:
        return message
    verb = "be " if rest.startswith("be ") else ""
    rest = rest.removeprefix("be ").replace("after validation, not", "but has")
    return f"it must {verb}{_IN_TOML.get(rest.partition(' or instance of ')[0], rest)}"


def _unknown(key: str, table: type[BaseModel] | None) -> tuple[str, str]:
    known = sorted(table.model_fields) if table else []
    # A key without its unit is the commonest slip: "current" for "current_mA".
    near = [k for k in known if k.startswith(f"{key}_")] or get_close_matches(key, known, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return "is not a known key", f"{hint}allowed here: {', '.join(known)}" if known else "this takes no options"


def _missing(key: str, table: type[BaseModel] | None, present: Any) -> str:
    known = table.model_fields if table else {}
    others = [k for k in present if k not in known] if isinstance(present, Mapping) else []
    near = get_close_matches(key, others, n=1)
    if near:
        return f"is {near[0]!r} a misspelling of it?"
    return f"it must be {describe_allowed(known[key])}" if key in known else ""


def describe_allowed(field: Any) -> str:
    """Describe the values a field takes: ``a number from 1 to 60``.

    Parameters
    ----------
    field : of a model, or an annotation.
    """
    if isinstance(field, FieldInfo):
        return field.description or _describe_annotation(field.annotation, field.metadata)
    return _describe_annotation(field, ())


def _describe_annotation(annotation: Any, rules: Sequence[Any]) -> str:
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        *most, last = map(repr, parts)
        return f"{', '.join(most)} or {last}" if most else last
    if origin in (list, tuple):
        least = _find_bound(rules, "min_length")
        length = f" of {len(parts)}"
        if Ellipsis in parts or len(parts) == 1:
            length = "" if least is None else f" of at least {least}"
        return f"an array{length}, each {_describe_annotation(parts[0], ())}"
    if origin is Annotated:
        inner = [rule for part in parts[1:] for rule in (part.metadata if isinstance(part, FieldInfo) else [part])]
        described = [part.description for part in parts[1:] if isinstance(part, FieldInfo) and part.description]
        return described[0] if described else _describe_annotation(parts[0], [*inner, *rules])
    if origin in (Union, UnionType):
        return " or ".join(_describe_annotation(part, rules) for part in parts if part is not NoneType)
    if origin is dict:
        return f"one named table or more, each {_describe_annotation(parts[1], ())}"
    table = _table(annotation)
    return _table_words(table) if table else _WORDS.get(annotation, "a value") + _bounds(rules)


def _table_words(table: type[BaseModel]) -> str:
    needed, optional = (
        [name for name, field in table.model_fields.items() if field.is_required() is required]
        for required in (True, False)
    )
    if not needed:  # of some, one is needed: rules of the table say so
        return f"a table of {', '.join(optional)}"
    return f"a table of {', '.join(needed)}" + (f" (optional: {', '.join(optional)})" if optional else "")


def _bounds(rules: Sequence[Any]) -> str:
    texts: list[str] = []
    for name in ("ge", "gt", "le", "lt"):
        bound = _find_bound(rules, name)
        if bound is None:
            texts.append("")
        else:
            texts.append(str(int(bound)) if abs(bound) < 1e9 and bound == int(bound) else f"{bound:g}")
    least, above, most, below = texts
    if least and most:
        return f" from {least} to {most}"
    low = f" of at least {least}" if least else f" above {above}" if above else ""
    high = f"at most {most}" if most else f"below {below}" if below else ""
    return low + (f" and {high}" if low else f" {high}" if below else f" of {high}") * bool(high)


def _find_bound(rules: Sequence[Any], name: str) -> Any:
    return next((value for rule in rules if (value := getattr(rule, name, None)) is not None), None)


def _field_at(model: type[BaseModel], path: KeyPath) -> Any:
    """Return the field (or annotation) at a key path; None if it is free-form."""
    current: Any = model
    for part in path:
        table, parts = _table(current), get_args(_bare(current))
        if table is not None:
            current = table.model_fields.get(str(part))
        elif isinstance(part, int) and part < len(parts) and Ellipsis not in parts:
            current = parts[part] if get_origin(_bare(current)) is tuple else parts[0]
        else:
            kinds = [a for a in parts if a is not Ellipsis]
            current = kinds[-1] if kinds else None
    return current


def _table(field: Any) -> type[BaseModel] | None:
    bare = _bare(field)
    return bare if isinstance(bare, type) and issubclass(bare, BaseModel) else None


def _bare(field: Any) -> Any:
    """Take a type out of its field, its annotations and its union with None."""
    if isinstance(field, FieldInfo):
        field = field.annotation
    while get_origin(field) in (Union, UnionType, Annotated):  # of Annotated the first is the type
        field = next(a for a in get_args(field) if a is not NoneType)
    return field
