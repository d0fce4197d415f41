"""What the models of all configuration files share: strict tables, problems, and how they are worded."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import date, time
from difflib import get_close_matches
from types import UnionType
from typing import Annotated, Any, Generic, TypeVar, Union, get_args, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from cbsr_qa.config.documents import Document, not_finite
from cbsr_qa.config.text import KeyPath, echo, line_of, printable
from cbsr_qa.domain import ConfigError, RefusedError

T = TypeVar("T")

#: Problems of a file that are listed, and characters of a key that are shown.
MOST_LISTED = 50
_LONGEST_KEY = 60

#: What pydantic calls things → what TOML calls them.
_IN_TOML = {
    "a valid dictionary": "a table",
    "a valid list": "an array",
    "a valid string": "text in quotes",
    "a valid number": "a number",
    "a valid integer": "a whole number",
    "a valid boolean": "true or false",
}


def _word(text: str) -> str:
    if re.fullmatch(r"[a-z][a-z0-9_]{0,63}", text):
        return text
    raise ValueError("it must be lower-case letters, digits and _, starting with a letter, at most 64 of them")


#: A name that code uses: of a role, of a measurement.
Word = Annotated[str, AfterValidator(_word)]


class Table(BaseModel):
    """A table of which every key is known."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class OpenTable(BaseModel):
    """A table whose other keys are options of a plugin, which checks them itself."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, allow_inf_nan=False)

    @property
    def options(self) -> dict[str, Any]:
        """The keys that are not the table's own."""
        return dict(self.model_extra or {})


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with a file: where, and what."""

    path: KeyPath
    what: str


class FileModel(Table, Generic[T]):
    """The whole of a configuration file."""

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong between keys that are right by themselves."""
        yield from ()

    def to_domain(self) -> T:
        """Return the domain object; units are converted here and nowhere else."""
        raise NotImplementedError


def validated(model: type[FileModel[T]], document: Document) -> T:
    """Check a document against its model and turn it into its domain object.

    Raises
    ------
    ConfigError
        Listing every problem of the file with its line, what was found and what is allowed.
    """
    problems = [Problem(path, "is not a finite number") for path in not_finite(document.data)]
    parsed: FileModel[T] | None = None
    try:
        parsed = model.model_validate(document.data)
    except ValidationError as error:
        details = [d for d in error.errors() if d["type"] != "finite_number"]
        problems += [_worded(model, document.data, detail) for detail in details]
        parsed = _without_unknown_keys(model, document.data, error.errors())
    if parsed is not None:
        problems += parsed.problems()
    if problems or parsed is None:
        raise refusal(document, problems)
    try:
        return parsed.to_domain()
    except RefusedError as error:  # a rule the domain keeps itself
        raise ConfigError(f"{document.label}: {error.reason}", remedy=error.remedy) from error


def _without_unknown_keys(
    model: type[FileModel[T]], data: Mapping[str, Any], errors: list[ErrorDetails]
) -> FileModel[T] | None:
    """Parse again without unknown keys, so that a typing error does not hide what else is wrong."""
    if any(e["type"] != "extra_forbidden" for e in errors):
        return None
    reduced: Any = _copied(data)
    for error in errors:
        place = reduced
        for key in error["loc"][:-1]:
            place = place[key]
        del place[error["loc"][-1]]
    try:
        return model.model_validate(reduced)
    except ValidationError:
        return None


def _copied(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {key: _copied(value) for key, value in data.items()}
    return [_copied(value) for value in data] if isinstance(data, list) else data


def refusal(document: Document, problems: list[Problem]) -> ConfigError:
    """Return the error that lists what is wrong with a file, each with its line; of very many the first ones."""
    some = "" if len(problems) <= MOST_LISTED else f", of which these are the first {MOST_LISTED}"
    lines = [f"{document.label} has {len(problems)} problem{'s' if len(problems) > 1 else ''}{some}:"]
    for problem in problems[:MOST_LISTED]:
        line = line_of(document.text, problem.path)
        where = f"line {line}: " if line else ""
        lines.append(f"  {where}{dotted(problem.path)} {problem.what}")
    what = "it" if len(problems) == 1 else "them"
    return ConfigError(
        "\n".join(lines), remedy=f"mend {what} and try again; docs/reference/configuration.md lists every key"
    )


def dotted(path: KeyPath) -> str:
    """Write a key path as a reader would: ``phases[2].options`` (positions count from 1, like the reader)."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part + 1}]"
        else:
            key = echo(part, _LONGEST_KEY) if len(part) > _LONGEST_KEY else printable(part)
            text += f".{key}" if text else key
    return text


def _worded(model: type[BaseModel], data: Mapping[str, Any], detail: ErrorDetails) -> Problem:
    path: KeyPath = tuple(part for part in detail["loc"] if part != "[key]")  # a key itself is wrong
    found = detail["input"]
    context = detail.get("ctx", {})
    table = table_at(model, path[:-1])
    match detail["type"]:
        case "extra_forbidden":
            what = _unknown_key(str(path[-1]), table)
        case "missing":
            what = _missing(str(path[-1]), table, found if isinstance(found, Mapping) else {})
        case "literal_error":
            what = f"is {_shown(found)}; allowed: {context['expected']}"
        case "value_error":
            what = f"is {_shown(found)}; {context['error']}"
        case _:
            what = f"is {_shown(found)}; {_rule(detail['msg'])}"
    return Problem(path, what)


def _rule(message: str) -> str:
    """Turn pydantic's sentence into ours: "Input should be greater than 0" becomes "it must be greater than 0"."""
    for start in ("Input should be ", "List should ", "Value should ", "Dictionary should ", "String should "):
        if message.startswith(start):
            verb = "be " if start == "Input should be " else ""
            rest = message.removeprefix(start).replace("after validation, not", "but has")
            return f"it must {verb}{_IN_TOML.get(rest.partition(' or instance of ')[0], rest)}"
    return message


def _unknown_key(key: str, table: type[BaseModel] | None) -> str:
    known = sorted(table.model_fields) if table else []
    # A key without its unit is the commonest slip: "current" for "current_mA".
    near = [k for k in known if k.startswith(f"{key}_")] or get_close_matches(key, known, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"is not a known key{hint} (allowed here: {', '.join(known)})"


def _missing(key: str, table: type[BaseModel] | None, present: Mapping[str, Any]) -> str:
    known = set(table.model_fields) if table else set()
    near = get_close_matches(key, [k for k in present if k not in known], n=1)
    return f"is missing{f'; is {near[0]!r} a misspelling of it?' if near else ''}"


def _shown(value: object) -> str:
    if isinstance(value, str):
        return echo(value)
    if isinstance(value, Mapping):
        return "a table"
    text = str(value) if isinstance(value, date | time) else repr(value)
    return text if len(text) <= 60 else f"{text[:60]}…"


def table_at(model: type[BaseModel], path: KeyPath) -> type[BaseModel] | None:
    """Return the model of the table at a key path; None where it is free-form."""
    current: Any = model
    for part in path:
        if isinstance(current, type) and issubclass(current, BaseModel):
            field = current.model_fields.get(str(part))
            current = None if field is None else field.annotation
        else:
            arguments = [a for a in get_args(current) if a is not type(None)]
            current = arguments[-1] if arguments else None
        while get_origin(current) in (Union, UnionType, Annotated):  # of Annotated the first is the type
            current = next(a for a in get_args(current) if a is not type(None))
    return current if isinstance(current, type) and issubclass(current, BaseModel) else None
