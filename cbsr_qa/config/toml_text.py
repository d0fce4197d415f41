"""Documents as TOML text: what configuration files are written with."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any


def toml_value(value: Any) -> str:
    """Write a value; tables stand inline.

    Raises
    ------
    TypeError
        If TOML has no such value, as None.
    """
    if isinstance(value, float):
        return float.__repr__(value)  # of numpy's floats too
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {toml_value(one)}" for key, one in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if not isinstance(value, str | int):
        raise TypeError(f"TOML has no value like {value!r}")
    return _text(value) if isinstance(value, str) else json.dumps(value)


def toml_document(document: Mapping[str, Any], comments: Sequence[str] = ()) -> str:
    """Write a document of tables: plain keys first, then tables, then arrays of tables.

    Parameters
    ----------
    comments : lines at the top.

    Returns
    -------
    Text that reads back as the same document. Tables within tables of an array stand inline.
    """
    lines = [f"# {one_line(comment)}".rstrip() for comment in comments]
    return "\n".join([*lines, *_table(document, ())]).strip() + "\n"


def one_line(text: str) -> str:
    """Replace what would end a comment."""
    return "".join(character if character.isprintable() else " " for character in text)


def _table(table: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    later = {key: value for key, value in table.items() if _is_table(value) or _is_tables(value)}
    for key, value in table.items():
        if key not in later:
            yield f"{_key(key)} = {toml_value(value)}"
    for key, value in later.items():
        name = ".".join(map(_key, (*path, key)))
        if _is_table(value):
            yield from ("", f"[{name}]", *_table(value, (*path, key)))
            continue
        for one in value:
            yield from ("", f"[[{name}]]", *(f"{_key(k)} = {toml_value(v)}" for k, v in one.items()))


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping) and bool(value)


def _is_tables(value: Any) -> bool:
    listed = isinstance(value, Sequence) and not isinstance(value, str)
    return listed and bool(value) and all(isinstance(one, Mapping) for one in value)


def _key(key: str) -> str:
    bare = key.isascii() and key.replace("-", "").replace("_", "").isalnum()
    return key if bare else _text(key)


def _text(text: str) -> str:
    """Quote text: as in JSON, but for one control character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
