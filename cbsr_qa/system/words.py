"""Quoting user input without flooding or upsetting a terminal."""

import sys
from collections.abc import Mapping
from datetime import date, time
from typing import Final

from cbsr_qa.domain.errors import CbsrError

KeyPath = tuple[str | int, ...]

#: Most characters shown of a key or a value.
_MAX_VALUE_LENGTH: Final = 60
#: Longest message of an error; longer ones are cut [characters].
_MAX_MESSAGE_LENGTH: Final = 500


def echo(text: str, longest: int = _MAX_VALUE_LENGTH) -> str:
    """Return text quoted, control characters escaped, cut after ``longest`` characters, with its full length."""
    if len(text) <= longest:
        return repr(text)
    return f"{text[:longest]!r}… ({len(text)} characters)"


def printable(text: str) -> str:
    """Return text unchanged if printable, otherwise quoted and escaped as by :func:`echo`."""
    return text if text.isprintable() else echo(text, 200)


def quote_value(value: object) -> str:
    """Return a value as text for a refusal; whole numbers may have thousands of digits."""
    if isinstance(value, str):
        return echo(value)
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, int) and abs(value) > sys.float_info.max:
        return "a whole number beyond 1.8e308"
    text = str(value) if isinstance(value, date | time) else repr(value)
    return text if len(text) <= _MAX_VALUE_LENGTH else f"{text[:_MAX_VALUE_LENGTH]}…"


def format_key_path(path: KeyPath) -> str:
    """Write a key path as a reader would: ``phases[2].options`` (positions count from 1, like the reader)."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part + 1}]"
        else:
            key = echo(part) if len(part) > _MAX_VALUE_LENGTH else printable(part)
            text += f".{key}" if text else key
    return text


def describe_error(error: BaseException) -> str:
    """Return type and message of an error, printable and of limited length; never raises."""
    try:
        text = error.reason if isinstance(error, CbsrError) else f"{type(error).__name__}: {error}"
    except KeyboardInterrupt:
        raise
    except BaseException:  # noqa: BLE001 - even its message is a plugin's code
        text = type(error).__name__
    plain = "".join(
        c if c.isprintable() or c == "\n" else "\N{REPLACEMENT CHARACTER}" for c in text[:_MAX_MESSAGE_LENGTH]
    )
    return plain + "…" * (len(text) > _MAX_MESSAGE_LENGTH)
