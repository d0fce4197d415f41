"""Signatures, members and results on the page of the Python interface, from its code."""

import dataclasses
import inspect
import re
import typing
from collections.abc import Iterator
from enum import Enum
from functools import cached_property
from typing import Any

import interface_pages

import cbsr_qa
from cbsr_qa.cli.command import documents
from cbsr_qa.interface.result import Result

_SECTION = re.compile(r"^### `(\w+)`\n\n(.*?)(?=^##|\Z)", re.M | re.S)
_ARRAY_LIKE = re.compile(r"Union\[numpy\._typing\._array_like\._Buffer.*?\[complex \| bytes \| str\](, NoneType)?\]")
_ARRAY = re.compile(r"numpy\.ndarray\[tuple\[typing\.Any, \.\.\.\], numpy\.dtype\[numpy\.\w+\]\]")
_RESULTS = """\
## What methods return

These classes have no constructor for you; arrays are numpy's.

"""


def python_page(written: str) -> str:
    """Return the page with what the code says beneath each name; of a class, the members that the page names."""
    results: dict[str, Any] = {}

    def section(found: re.Match[str]) -> str:
        name, text = found.groups()
        value = getattr(cbsr_qa, name)
        lines = [f"### `{name}`", "", *_signature(name, value), text.rstrip(), "", *_about(value, text, results)]
        return "\n".join(lines).rstrip() + "\n\n"

    page = _SECTION.sub(section, written)
    return page + _RESULTS + "\n".join(line for kind in results.values() for line in _result(kind))


def _signature(name: str, value: Any) -> list[str]:
    return [] if inspect.isclass(value) else [*_code(name, value), ""]


def _about(value: Any, text: str, results: dict[str, Any]) -> Iterator[str]:
    """Yield parameters of a function, members of a class; add the classes that methods return to ``results``."""
    if not inspect.isclass(value):
        yield interface_pages.markdown(value).partition("\n\n")[2]
        return
    if issubclass(value, Enum):
        yield from _members(value)
        return
    if issubclass(value, Result) and (words := _command(value)):
        yield f"`result` has [the keys of `cbsr-qa {words} --json`](schemas.md#{words.replace(' ', '-')})."
        yield ""
    if re.search(rf"\b{value.__name__}\(", text):
        yield from _code(value.__name__, value)
        yield ""
    for name, member in inspect.getmembers(value):
        if name.startswith("_") or not re.search(rf"[`.]{name}\b", text):
            continue
        yield from _member(f"{value.__name__}.{name}", member)
        for kind in _classes(member):
            results.setdefault(kind.__name__, kind)


def _member(name: str, member: Any) -> Iterator[str]:
    if isinstance(member, property | cached_property):
        member = member.fget if isinstance(member, property) else member.func
        yield f"`{name}`: {interface_pages.markdown(member)}"
    elif callable(member):
        yield from _code(name, member)
        yield ""
        yield interface_pages.markdown(member)
    yield ""


def _members(kind: type[Enum]) -> Iterator[str]:
    comments = dict(re.findall(r"^    (\w+) = \d+  #: (.*)", inspect.getsource(kind), re.M))
    yield "| flag | number | meaning |"
    yield "| --- | --- | --- |"
    yield from (f"| `{member.name}` | {member.value} | {comments[str(member.name)]} |" for member in kind)


def _command(value: type) -> str:
    """Return the words of the command whose document a result holds; empty if no command prints it."""
    (held,) = typing.get_args(value.__orig_bases__[0]) if value is not Result else (None,)  # type: ignore[attr-defined]
    return next((words for words, kind in documents().items() if kind is held or held in typing.get_args(kind)), "")


def _classes(member: Any) -> Iterator[Any]:
    """Yield classes without a section that a method returns, alone or in a tuple."""
    returned = inspect.signature(member).return_annotation if callable(member) else None
    for kind in (returned, *typing.get_args(returned)):
        if dataclasses.is_dataclass(kind) and kind not in vars(cbsr_qa).values():
            yield kind


def _result(kind: Any) -> Iterator[str]:
    yield f"### `{kind.__name__}`"
    yield ""
    yield interface_pages.markdown(kind).replace("**Parameters**", "**Fields**")
    yield ""
    for name, member in vars(kind).items():
        if not name.startswith("_") and (isinstance(member, property) or inspect.isfunction(member)):
            yield from _member(f"{kind.__name__}.{name}", member)


def _code(name: str, value: Any) -> list[str]:
    text = str(inspect.signature(value)).replace("(self, ", "(").replace("(self)", "()")
    text = _ARRAY_LIKE.sub(lambda found: "ArrayLike | None" if found[1] else "ArrayLike", text)
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", text)  # annotations that were quoted
    return interface_pages.code(f"{name}{_ARRAY.sub('Array', text)}".removesuffix(" -> None"))
