"""Options shared by commands, and plugin options: KEY=VALUE, each value as in a recipe."""

import re
import tomllib
from collections.abc import Iterable, Sequence
from datetime import date, datetime
from difflib import get_close_matches
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from cbsr_qa.config.documents import find_not_finite
from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.system.words import echo

_Word = TypeVar("_Word", bound=StrEnum)

#: Options of most commands.
Database = Annotated[
    str | None, typer.Option(metavar="URL|FILE", help="SQLAlchemy URL or SQLite file; by default var/cbsr-qa.db.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Since = Annotated[datetime | None, typer.Option(formats=["%Y-%m-%d"], help="Runs from this day on (UTC).")]
Until = Annotated[datetime | None, typer.Option(formats=["%Y-%m-%d"], help="Runs to the end of this day (UTC).")]
Parts = Annotated[
    list[str] | None,
    typer.Option(
        "--part", metavar="NAME=ID[/REVISION]", help="Part of the sensor, as sheet=LOT7/B; may be repeated."
    ),
]
OfParts = Annotated[
    list[str] | None,
    typer.Option("--part", metavar="NAME=ID[/REVISION]", help="Runs of sensors with this part; may be repeated."),
]
PublicKey = Annotated[
    Path | None, typer.Option(help="Public key that must have signed the calibration; any other file is refused.")
]
CertificateSignature = Annotated[
    Path | None,
    typer.Option(help="Signature file of the calibration's certificate; a lapsed or withdrawn one is refused."),
]
Withdrawn = Annotated[
    Path | None, typer.Option(help="List of withdrawn certificates, written by certificate withdrawn.")
]
PageOutput = Annotated[Path | None, typer.Option("--output", help="HTML page to write.")]


def one_of(words: type[_Word], given: str, option: str) -> _Word:
    """Return the given word. RefusedError, with the nearest one, if it is not allowed."""
    allowed = [str(word) for word in words]
    if given in allowed:
        return words(given)
    near = get_close_matches(given, allowed, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise RefusedError(f"{option} {given[:64]!r} is not known", remedy=f"{hint}allowed: {', '.join(allowed)}")


def list_given_options(context: typer.Context) -> set[str]:
    """Return the names of the parameters that were given on the command line or in the environment."""
    # Compared by name, as typer may use its own copy of click's enumeration.
    sources = {name: context.get_parameter_source(name) for name in context.params}
    return {name for name, source in sources.items() if source is not None and source.name != "DEFAULT"}


def option_names(parameters: Iterable[str]) -> str:
    """Return parameters as they are typed: ``--by-location, --since``."""
    return ", ".join(f"--{name.replace('_', '-')}" for name in parameters)


def to_day(moment: datetime | None) -> date | None:
    """Return the day of a date option; None if it was not given."""
    return None if moment is None else moment.date()


_REMEDY = "give KEY=VALUE, e.g. noise_figure=0.5, choose=gcv or 'target_diameters_mm=[8, 13]'"


def plugin_options(given: Sequence[str]) -> dict[str, Any]:
    """Parse options by the rules of a recipe's tables.

    Parameters
    ----------
    given : each ``KEY=VALUE``, the value in TOML, otherwise text.

    Raises
    ------
    ConfigError
        If one is malformed, its value is missing or not finite, or a key is repeated.
    """
    options: dict[str, Any] = {}
    for text in given:
        key, equals, value = text.partition("=")
        key = key.strip()
        if not (equals and re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", key)):
            raise ConfigError(f"--option {echo(text)} is not of the form KEY=VALUE", remedy=_REMEDY)
        if not value.strip():
            raise ConfigError(f"--option {key} has no value", remedy=_REMEDY)
        if key in options:
            raise ConfigError(f"--option {key} is given twice", remedy="give it once")
        options[key] = _value(value.strip())
    for path in find_not_finite(options):
        raise ConfigError(f"--option {path[0]} is not a finite number", remedy=_REMEDY)
    return options


def _value(text: str) -> Any:
    try:
        data = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError):
        return text
    return data["value"] if set(data) == {"value"} else text
