"""The reference of commands, from the typer application and the pages that show them."""

import re
import shlex
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from typer.main import get_command

from cbsr_qa.cli.command import commands, documents
from cbsr_qa.cli.main import app

_BEGIN = """\
# Commands

This page lists every command of `cbsr-qa`, its arguments and options.
`cbsr-qa COMMAND --help` prints the same, and `cbsr-qa --version` the version. After `cbsr-qa --install-completion`, a
new terminal (bash, zsh, fish) completes commands and options when you press Tab.

| exit code | means |
| --- | --- |
| 0 | passed, or done |
| 1 | a sensor, a station or a check failed |
| 2 | refused: a file, a name or an option; nothing was done |
| 3 | aborted, broken off, or could not be measured |

With `--json`, a command prints one document to standard output and nothing else; [its keys](schemas.md) are stated.
"""


def command_page(docs: Path) -> str:
    """Return the page, in Markdown."""
    shown, printed = _shown(docs), documents()
    parts = [_BEGIN]
    for words, command in _commands():
        parts += ["\n".join([*_entry(words, command, words in printed), *_examples(shown[words])])]
    return "\n\n".join(parts) + "\n"


def _commands() -> Iterator[tuple[str, Any]]:
    """Yield words and typer's command, in the order of the program's own help."""
    for command in commands():
        found: Any = get_command(app)
        for word in command.words.split():
            found = found.commands[word]
        yield command.words, found


def _entry(words: str, command: Any, has_document: bool) -> Iterator[str]:
    visible = [parameter for parameter in command.params if not getattr(parameter, "hidden", False)]
    arguments = [parameter for parameter in visible if parameter.param_type_name == "argument"]
    options = [parameter for parameter in visible if parameter.param_type_name == "option"]
    yield f"## `cbsr-qa {words}`"
    yield ""
    yield re.sub(r"(?<![\w`-])--[a-z][\w-]*", r"`\g<0>`", command.help or "")
    yield ""
    yield f"    cbsr-qa {' '.join([words, *map(_argument, arguments)])}{' [OPTIONS]' if options else ''}"
    yield ""
    for heading, parameters in (("argument", arguments), ("option", options)):
        if parameters:
            yield f"| {heading} | value | meaning |"
            yield "| --- | --- | --- |"
            yield from (f"| {' | '.join(_cells(parameter))} |" for parameter in parameters)
            yield ""
    if has_document:
        yield f"Document of `--json`: [its keys](schemas.md#{words.replace(' ', '-')})."
        yield ""


def _argument(argument: Any) -> str:
    name = f"{argument.metavar}{'…' if argument.nargs == -1 else ''}"
    return name if argument.required else f"[{name}]"


def _cells(parameter: Any) -> list[str]:
    """Return name, value and meaning, which ends with the default."""
    if parameter.param_type_name == "argument":
        name, value = f"`{parameter.metavar}`", ""
    else:
        name = ", ".join(f"`{option}`" for option in (*parameter.opts, *parameter.secondary_opts))
        value = parameter.metavar and f"`{parameter.metavar}`"
    meaning = " ".join((parameter.help or "").split())
    if getattr(parameter, "multiple", False) and "repeated" not in meaning:
        meaning = f"{meaning.rstrip('.')}; may be repeated."
    default = parameter.opts[0] if parameter.default is True else parameter.default
    if parameter.required and parameter.param_type_name == "option":
        meaning += " Required."
    elif isinstance(default, str | int | float) and default not in (False, ""):
        meaning += f" Default: `{default}`."
    return [name, value or "", meaning]


def _shown(docs: Path) -> Mapping[str, list[tuple[str, str, str]]]:
    """Return by command what pages tell their readers to type: title and path of the page, and the line."""
    known = sorted((words for words, _ in _commands()), key=len, reverse=True)
    shown: dict[str, list[tuple[str, str, str]]] = defaultdict(list)
    for page in sorted(docs.rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        title = text.removeprefix("# ").partition("\n")[0]
        for block in re.findall(r"^```console\n(.*?)^```", text, re.M | re.S):
            for line in re.findall(r"^\$ (cbsr-qa .*)", block, re.M):
                typed = " ".join(shlex.split(line)[1:])
                words = next((words for words in known if f"{typed} ".startswith(f"{words} ")), "")
                shown[words].append((title, str(page.relative_to(docs)), line))
    return shown


def _examples(shown: list[tuple[str, str, str]]) -> Iterator[str]:
    if not shown:
        return
    lines = dict.fromkeys(line for _, _, line in shown)
    pages = dict.fromkeys((title, path) for title, path, _ in shown)
    yield "```console"
    yield from (f"$ {line}" for line in list(lines)[:3])
    yield "```"
    yield ""
    yield f"From: {', '.join(f'[{title}](../{path})' for title, path in pages)}."
