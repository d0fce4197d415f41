"""Reference pages of documents, hooks and the Python interface, from their code."""

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

from cbsr_qa.cli.command import documents
from cbsr_qa.plugin import hooks as hook_module
from cbsr_qa.report.document import json_schema

#: Doors that a plugin author takes names from.
DOORS = (
    "cbsr_qa.plugin",
    "cbsr_qa.plugin.links",
    "cbsr_qa.domain",
    "cbsr_qa.domain.readings",
    "cbsr_qa.domain.results",
    "cbsr_qa.domain.run",
    "cbsr_qa.domain.sensor",
    "cbsr_qa.testing",
)


_SCHEMAS = """\
# Documents of `--json`

This page lists the keys of what each command prints with `--json`, of the events of a run, and of the messages of
a stream. `cbsr-qa schema COMMAND` prints the same as JSON Schema (draft 2020-12). The parts that documents share come
after them.
"""


def schemas() -> str:
    """Return the page on what commands print with ``--json``."""
    lines = [_SCHEMAS]
    parts: dict[str, Any] = {}
    for words, kind in documents().items():
        schema = _with_own_names(json_schema(kind), words, parts)
        parts |= schema.pop("$defs", {})
        lines += [f"## {words}", ""]
        if forms := schema.get("anyOf") or schema.get("oneOf"):
            lines += [f"One of: {', '.join(map(_kind, forms))}.", ""]
        else:
            lines += _keys(schema)
    lines += ["## Parts of documents", ""]
    for name, part in sorted(parts.items()):
        lines += [f"### {name}", "", *_keys(part)]
    return "\n".join(lines)


def _with_own_names(schema: dict[str, Any], words: str, parts: Mapping[str, Any]) -> dict[str, Any]:
    """Rename parts whose names stand for something else on the page: another part, or a command."""
    text = json.dumps(schema)
    for name, part in schema.get("$defs", {}).items():
        if parts.get(name, part) != part or name.lower() in documents():
            own = f"{name} of {words}"
            text = text.replace(f'"#/$defs/{name}"', f'"#/$defs/{own}"').replace(f'"{name}": {{', f'"{own}": {{')
    renamed: dict[str, Any] = json.loads(text)
    return renamed


def _keys(schema: Mapping[str, Any]) -> Iterator[str]:
    """Yield the description of an object, and a table of its keys."""
    description = _plain(schema.get("description", ""))
    meanings = {
        name: " ".join(words.split())
        for names, words in re.findall(r"^- `([^`]+)`: (.*(?:\n +.*)*)", description, re.M)
        for name in names.split(", ")
    }
    yield description.partition("\n\n**")[0]
    yield ""
    if properties := schema.get("properties", {}):
        yield "| key | type | meaning |"
        yield "| --- | --- | --- |"
        for key, value in properties.items():
            absent = "" if key in schema.get("required", ()) or "default" in value else " or absent"
            yield f"| `{key}` | {_kind(value)}{absent} | {meanings.get(key, '').replace('|', '/')} |"
    else:
        yield f"{_kind(schema).capitalize()}."
    yield ""


def _kind(value: Mapping[str, Any]) -> str:
    """Return the type of a value in words."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower().replace(' ', '-')})"
    if choices := value.get("anyOf") or value.get("oneOf"):
        return " or ".join(dict.fromkeys(map(_kind, choices)))
    if allowed := [value["const"]] if "const" in value else value.get("enum"):
        return " or ".join(f"`{json.dumps(word)}`" for word in allowed)
    if value.get("type") == "array":
        within = value.get("prefixItems") or [value.get("items", {})]
        return f"list of {' and '.join(dict.fromkeys(map(_kind, within)))}"
    if isinstance(values := value.get("additionalProperties"), Mapping):
        return f"object of {_kind(values)}"
    return str(value.get("type", "any value"))


def hooks() -> str:
    """Return the page on the hooks of plugins."""
    lines = [
        "# Hooks",
        "",
        "This page lists the functions that a plugin's module may have, each under `@hookimpl` of `cbsr_qa.plugin`.",
        "[Write a plugin](../how-to/write-a-plugin.md) shows how to use them;",
        "[the interface for plugins](plugin-interface.md) lists the classes that they take.",
    ]
    named = vars(hook_module).items()
    for name, hook in named:
        if inspect.isfunction(hook) and name.startswith("cbsr_"):
            lines += ["", f"## `{name}`", "", *code(f"{name}{inspect.signature(hook)}"), "", markdown(hook)]
    lines += ["", "## What `register` takes", "", "| kind | its factory is |", "| --- | --- |"]
    source = inspect.getsource(hook_module.Kind)
    lines += [f"| `{kind}` | {words} |" for kind, words in re.findall(r'= "(\w+)"  #: (.*)', source)]
    return "\n".join([*lines, "", "## `Veto`", "", markdown(hook_module.Veto)]) + "\n"


def interface() -> str:
    """Return the page on the packages that a plugin imports from."""
    lines = [
        "# Python interface for plugins",
        "",
        "This page lists the names that a plugin can import, by package. `help(NAME)`",
        "prints the rest. [Write a plugin](../how-to/write-a-plugin.md) shows the most important ones at work.",
    ]
    for door in DOORS:
        package = import_module(door)
        lines += ["", f"## `{door}`", "", markdown(package).partition("\n\n")[0], ""]
        for name in sorted(dir(package), key=str.lower):
            if not name.startswith("_") and not inspect.ismodule(value := getattr(package, name)):
                lines += _named(name, value)
    return "\n".join(lines) + "\n"


def _named(name: str, value: Any) -> Iterator[str]:
    yield f"### `{name}`"
    yield ""
    if isinstance(value, int | float | str | tuple):
        yield from [f"Constant: `{value!r:.100}`", ""]
        return
    if not callable(value) or not hasattr(value, "__name__"):
        yield from ["Type of an annotation.", ""]
        return
    if text := _signature(value):
        yield from [*code(f"{name}{text}"), ""]
    yield from [markdown(value).partition("\n\n")[0], ""]


def _signature(value: Any) -> str:
    if inspect.isclass(value) and getattr(value, "_is_protocol", False):
        return ""
    try:
        return str(inspect.signature(value))
    except (TypeError, ValueError):
        return ""


def code(line: str) -> list[str]:
    """Return a signature as a block of code, one parameter on each line if it is long."""
    line = re.sub(r"<factory>|<(\w+\.\w+): [^>]*>", lambda found: found[1] or "…", line)
    line = re.sub(r"\b(?:cbsr_qa|collections|numpy|pathlib|typing|datetime)(?:\.\w+)*\.(?=[A-Za-z])", "", line)
    if len(line) > 84:
        line = re.sub(r", (?=(?:\*|\*\*)?\w+(?::|,|=|$|\))|\*,)", ",\n    ", line).replace("(", "(\n    ", 1)
    return ["```python", line, "```"]


def markdown(value: Any) -> str:
    """Return a docstring as Markdown."""
    return _plain(inspect.getdoc(value) or "")


def _plain(docstring: str) -> str:
    text = re.sub(r":\w+:`~?([^`<]*?)(?: <[^>]*>)?`", lambda role: f"`{role[1].rpartition('.')[2]}`", docstring)
    text = re.sub(r"docs/reference/([\w-]+\.md)", r"[\1](\1)", text.replace("``", "`"))
    text = re.sub(r"^(\w[\w ]*)\n-+\n", r"**\1**\n\n", text, flags=re.M)
    text = re.sub(r"^(\w+(?:, \w+)*)\n(?= {4}\w)", r"- `\1`:\n", text, flags=re.M)  # of errors
    return re.sub(r"^(\w+(?:, \w+)*) : ", r"- `\1`: ", text, flags=re.M)
