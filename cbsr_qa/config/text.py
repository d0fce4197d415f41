"""Text of TOML files: written, and located (on which line a key stands) for error messages only."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

from cbsr_qa.system.words import KeyPath


def plainly(number: float) -> str:
    """Return a number in few digits if that is exact."""
    short = f"{number:g}"
    return short if float(short) == number else repr(number)


_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_KEY = re.compile(r"""^\s*((?:[A-Za-z0-9_.-]|"[^"]*"|'[^']*')+)\s*=""")


def line_of(text: str, path: KeyPath) -> int | None:
    """Find the line of a key, or of the innermost table around it.

    Parameters
    ----------
    path : keys and 0-based positions in arrays of tables, as pydantic gives them.

    Returns
    -------
    1-based line, or None if the outermost table is not in the text (or in a form this scan does not follow, such as
    tables inside inline arrays).
    """
    line_by_path = _first_lines(text)
    return next(
        (line_by_path[path[:length]] for length in range(len(path), 0, -1) if path[:length] in line_by_path), None
    )


@lru_cache(maxsize=1)  # a file with a thousand problems is scanned once
def _first_lines(text: str) -> dict[KeyPath, int]:
    """Return the first line of every key, and of every table with content."""
    line_by_path: dict[KeyPath, int] = {}
    for line, place in _places(text):
        for length in range(1, len(place) + 1):
            line_by_path.setdefault(place[:length], line)
    return line_by_path


def _places(text: str) -> Iterator[tuple[int, KeyPath]]:
    table: KeyPath = ()
    counts: dict[KeyPath, int] = {}
    open_delimiter = ""  # the delimiter of a multi-line string that is open
    # Only line feeds end lines in TOML; texts and comments may hold other separators, such as U+2028.
    for number, line in enumerate(text.split("\n"), start=1):
        in_string = bool(open_delimiter)
        open_delimiter = _open_string(line, open_delimiter)
        if in_string:
            continue
        if header := _HEADER.match(line):
            names = _insert_positions(_split(header[2]), counts)
            if header[1] == "[[":
                counts[names] = counts.get(names, -1) + 1
                names = (*names, counts[names])
            table = names
            yield number, table
        elif key := _KEY.match(line):
            yield number, (*table, *_split(key[1]))


def _insert_positions(names: KeyPath, counts: dict[KeyPath, int]) -> KeyPath:
    """Insert the positions of the arrays of tables that a header passes through."""
    path: KeyPath = ()
    for name in names[:-1]:
        path = (*path, name)
        if path in counts:
            path = (*path, counts[path])
    return (*path, names[-1])


def _split(dotted: str) -> KeyPath:
    return tuple(part.strip().strip("\"'") for part in re.findall(r""""[^"]*"|'[^']*'|[^.]+""", dotted))


def _open_string(line: str, inside: str) -> str:
    for delimiter in re.findall(r'"""|\'\'\'', line):
        if not inside:
            inside = delimiter
        elif inside == delimiter:
            inside = ""
    return inside


def toml_value(value: Any) -> str:
    """Write a value; tables are inline.

    Raises
    ------
    TypeError
        If TOML has no such value, e.g. None.
    """
    if isinstance(value, float):
        return float.__repr__(value)  # of numpy's floats too
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if not isinstance(value, str | int):
        raise TypeError(f"TOML has no value like {value!r}")
    return _text(value) if isinstance(value, str) else json.dumps(value)


def toml_document(document: Mapping[str, Any], comments: Sequence[str] = ()) -> str:
    """Write a document of tables: plain keys first, then tables, then arrays of tables.

    Parameters
    ----------
    comments : comment lines at the top.

    Returns
    -------
    Text that reads back as the same document. Tables within tables of an array are inline.
    """
    lines = [f"# {one_line(comment)}".rstrip() for comment in comments]
    return "\n".join([*lines, *_table(document, ())]).strip() + "\n"


def one_line(text: str) -> str:
    """Return text for a comment: a space replaces every character that would end it."""
    return "".join(character if character.isprintable() else " " for character in text)


def _table(table: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    nested = {key: value for key, value in table.items() if _is_table(value) or _is_tables(value)}
    for key, value in table.items():
        if key not in nested:
            yield f"{_key(key)} = {toml_value(value)}"
    for key, value in nested.items():
        name = ".".join(map(_key, (*path, key)))
        if _is_table(value):
            has_own_keys = any(not (_is_table(item) or _is_tables(item)) for item in value.values())
            yield from (*(("", f"[{name}]") if has_own_keys else ()), *_table(value, (*path, key)))
            continue
        for item in value:
            yield from ("", f"[[{name}]]", *(f"{_key(k)} = {toml_value(v)}" for k, v in item.items()))


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping) and bool(value)


def _is_tables(value: Any) -> bool:
    listed = isinstance(value, Sequence) and not isinstance(value, str)
    return listed and bool(value) and all(isinstance(item, Mapping) for item in value)


def _key(key: str) -> str:
    bare = key.isascii() and key.replace("-", "").replace("_", "").isalnum()
    return key if bare else _text(key)


def _text(text: str) -> str:
    """Quote text as JSON does, except for one control character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
