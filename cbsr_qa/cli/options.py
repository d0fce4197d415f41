"""Options of a plugin on the command line: KEY=VALUE, each value as a recipe would hold it.

Options that take one of a few words.
"""

import re
import tomllib
from collections.abc import Sequence
from datetime import date, datetime
from difflib import get_close_matches
from enum import StrEnum
from typing import Any, TypeVar

from cbsr_qa.config import not_finite
from cbsr_qa.domain import ConfigError, RefusedError
from cbsr_qa.plugin import echo

_Word = TypeVar("_Word", bound=StrEnum)


def one_of(words: type[_Word], said: str, option: str) -> _Word:
    """Return the word meant.

    Raises
    ------
    RefusedError
        If it is none of them, with the nearest one.
    """
    allowed = [str(word) for word in words]
    if said in allowed:
        return words(said)
    near = get_close_matches(said, allowed, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise RefusedError(f"{option} {said[:64]!r} is not known", remedy=f"{hint}allowed: {', '.join(allowed)}")


def to_day(moment: datetime | None) -> date | None:
    """Return the day of an option that is one; None where it was not given."""
    return None if moment is None else moment.date()


_REMEDY = "give KEY=VALUE, e.g. noise_figure=0.5, choose=gcv or 'target_diameters_mm=[8, 13]'"


def plugin_options(given: Sequence[str]) -> dict[str, Any]:
    """Read options as the tables of a recipe hold them.

    Parameters
    ----------
    given : each ``KEY=VALUE``, the value in TOML. What is no TOML is text, so that a shell's quotes will do for text.

    Raises
    ------
    ConfigError
        If one is not of that form, has no value or one that is not finite, or a key is given twice.
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
    for path in not_finite(options):
        raise ConfigError(f"--option {path[0]} is not a finite number", remedy=_REMEDY)
    return options


def _value(text: str) -> Any:
    try:
        data = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError):
        return text
    return data["value"] if set(data) == {"value"} else text
