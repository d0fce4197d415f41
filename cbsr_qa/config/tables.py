"""Shared by the models of all configuration files: strict tables, problems, and their wording."""

import re
from collections.abc import Iterator
from datetime import date, datetime
from pathlib import Path
from typing import Annotated, Any, Final, Generic, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from cbsr_qa.config.choices import Choice, check_choice
from cbsr_qa.config.documents import REFERENCE, Document, find_not_finite
from cbsr_qa.config.text import line_of
from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.domain.filling import fill_from_mapping
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.problems import CheckedTable, Problem, check

T = TypeVar("T")
D = TypeVar("D")
_PERCENT = "_percent"
_WORD_RULE = "lower-case letters, digits and _, starting with a letter, at most 64 of them"
_DATE_RULE = "a date like 2027-03-31"

#: Most problems of a file that are listed.
MOST_LISTED = 50


def _word(text: str) -> str:
    if re.fullmatch(r"[a-z][a-z0-9_]{0,63}", text):
        return text
    raise ValueError(f"it must be {_WORD_RULE}")


#: Name that code uses, as of a role or a measurement.
Word = Annotated[str, AfterValidator(_word), Field(description=_WORD_RULE)]


def _printable(text: str) -> str:
    if text.isprintable():
        return text
    raise ValueError("it must be text that can be printed, in one line")


#: Refuses control characters, line breaks, and characters that turn or hide others.
PRINTABLE: Final = AfterValidator(_printable)
PrintableLine = Annotated[str, PRINTABLE]


def _iso_date(value: Any) -> str:
    """Take a TOML date or the same as text; keep it as text."""
    if isinstance(value, date) and not isinstance(value, datetime):
        return value.isoformat()
    if not isinstance(value, str):
        raise ValueError(f"it must be {_DATE_RULE}")
    try:
        return date.fromisoformat(value).isoformat()
    except ValueError:
        raise ValueError(f"it must be {_DATE_RULE}") from None


#: Date as ISO text.
IsoDate = Annotated[str, BeforeValidator(_iso_date), Field(description=_DATE_RULE)]


class OpenTable(BaseModel):
    """A table whose other keys are options of a plugin, which checks them itself."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, allow_inf_nan=False)

    @property
    def options(self) -> dict[str, Any]:
        return dict(self.model_extra or {})


class FileModel(CheckedTable, Generic[T]):
    """The whole of a configuration file."""

    @classmethod
    def choices(cls, data: Any) -> Iterator[Choice]:
        """Yield the plugins that a file names; unreadable parts are skipped."""
        yield from ()

    @classmethod
    def plugin_problems(cls, data: Any, plugins: Plugins) -> Iterator[Problem]:
        """Yield problems of plugins and their options."""
        for choice in cls.choices(data):
            yield from check_choice(choice, plugins)[1]

    def to_domain(self) -> T:
        """Return the domain object; units are converted here and nowhere else."""
        raise NotImplementedError


def as_domain(kind: type[D], table: BaseModel, **others: Any) -> D:
    """Return a domain object of a table; ``others`` take precedence, and ``x_percent`` becomes the fraction ``x``."""
    values = {name: getattr(table, name) for name in type(table).model_fields}
    percent = {name.removesuffix(_PERCENT): value for name, value in values.items() if name.endswith(_PERCENT)}
    return fill_from_mapping(kind, {name: _fraction(value) for name, value in percent.items()} | values, **others)


def _fraction(percent: float | list[float] | None) -> float | list[float] | None:
    if isinstance(percent, list):
        return [value / 100 for value in percent]
    return None if percent is None else percent / 100


def validate(model: type[FileModel[T]], document: Document, plugins: Plugins | None = None) -> T:
    """Check a document against its model and turn it into its domain object.

    Parameters
    ----------
    plugins : installed plugins, to check their options as well; None checks none.

    Raises
    ------
    ConfigError
        Listing every problem of the file with line, value found and allowed values.
    """
    infinite_problems = [Problem(path, "is not a finite number") for path in find_not_finite(document.data)]
    parsed, problems = check(model, document.data)
    problems += () if plugins is None else model.plugin_problems(document.data, plugins)
    problems = [
        *infinite_problems,
        *(p for p in problems if all(p.path != infinite_problem.path for infinite_problem in infinite_problems)),
    ]
    if problems or parsed is None:
        raise refusal(document, problems)
    try:
        return parsed.to_domain()
    except RefusedError as error:  # a rule the domain keeps itself
        raise ConfigError(f"{document.label}: {error.reason}", remedy=error.remedy) from error


def refusal(document: Document, problems: list[Problem]) -> ConfigError:
    """Return the error that lists the first problems of a file, each with its line."""
    shown_part = "" if len(problems) <= MOST_LISTED else f", of which these are the first {MOST_LISTED}"
    lines = [f"{document.label} has {len(problems)} problem{'s' if len(problems) > 1 else ''}{shown_part}:"]
    located_problems = [(line_of(document.text, problem.path), problem) for problem in problems]
    file = Path(document.label).name
    for line, problem in sorted(located_problems, key=lambda each: each[0] or 0)[:MOST_LISTED]:
        place = f"{file} line {line}: " if line else ""
        lines.append(f"  {place}{problem}")
    pronoun = "it" if len(problems) == 1 else "them"
    return ConfigError("\n".join(lines), remedy=f"correct {pronoun} and try again; {REFERENCE} lists every key")
