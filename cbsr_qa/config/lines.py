"""On which line of a TOML file a key stands: cheap, for error messages only."""

import re
from collections.abc import Iterator
from functools import lru_cache

KeyPath = tuple[str | int, ...]

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_KEY = re.compile(r"""^\s*((?:[A-Za-z0-9_.-]|"[^"]*"|'[^']*')+)\s*=""")


def line_of(text: str, path: KeyPath) -> int | None:
    """Find the line of a key, or of the innermost table around it.

    Parameters
    ----------
    path : keys and 0-based positions in arrays of tables, as pydantic gives them.

    Returns
    -------
    1-based line, or None where not even the outermost table is in the text (or it was written in a form
    this scan does not follow, such as tables inside inline arrays).
    """
    first = _first_lines(text)
    return next((first[path[:length]] for length in range(len(path), 0, -1) if path[:length] in first), None)


@lru_cache(maxsize=1)  # a file with a thousand problems is scanned once
def _first_lines(text: str) -> dict[KeyPath, int]:
    """First line of every key, and of every table by what is within it."""
    first: dict[KeyPath, int] = {}
    for line, place in _places(text):
        for length in range(1, len(place) + 1):
            first.setdefault(place[:length], line)
    return first


def _places(text: str) -> Iterator[tuple[int, KeyPath]]:
    table: KeyPath = ()
    counts: dict[KeyPath, int] = {}
    inside = ""  # the delimiter of a multi-line string that is open
    # Only line feeds end lines in TOML; texts and comments may hold other separators, such as U+2028.
    for number, line in enumerate(text.split("\n"), start=1):
        opened = bool(inside)
        inside = _open_string(line, inside)
        if opened:
            continue
        if header := _HEADER.match(line):
            names = _indexed(_split(header[2]), counts)
            if header[1] == "[[":
                counts[names] = counts.get(names, -1) + 1
                names = (*names, counts[names])
            table = names
            yield number, table
        elif key := _KEY.match(line):
            yield number, (*table, *_split(key[1]))


def _indexed(names: KeyPath, counts: dict[KeyPath, int]) -> KeyPath:
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
