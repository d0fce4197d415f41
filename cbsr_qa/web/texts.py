"""The catalogue of what the pages say: ``texts.toml``. Its values may hold ``{names}`` that a page fills in."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any, Final

from cbsr_qa.domain.errors import CbsrError, drop_command_lines

_FILE: Final = "texts.toml"


@cache
def _catalogue() -> Mapping[str, str]:
    text_by_key: dict[str, str] = {}
    source = files(__package__).joinpath(_FILE).read_text(encoding="utf-8")
    for group, texts in tomllib.loads(source).items():
        text_by_key |= {f"{group}.{key}": value for key, value in texts.items()}
    return text_by_key


def text(key: str, **names: Any) -> str:
    """Return a text of the catalogue. KeyError if it has none of this key."""
    return _catalogue()[key].format(**names)


def refusal_words(error: CbsrError) -> str:
    """Return the reason of an error and its remedy, in words of a page."""
    remedy = drop_command_lines(error.remedy)
    if not remedy.startswith("cbsr-qa"):
        remedy = remedy[:1].upper() + remedy[1:]
    return f"{error.reason}. {remedy}" if remedy else error.reason


def keys() -> frozenset[str]:
    """All keys of the catalogue."""
    return frozenset(_catalogue())
