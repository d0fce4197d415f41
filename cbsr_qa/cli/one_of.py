"""Options that take one of a few words."""

from difflib import get_close_matches
from enum import StrEnum
from typing import TypeVar

from cbsr_qa.domain.errors import RefusedError

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
