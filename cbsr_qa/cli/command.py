"""Declaration of commands, in any file of this package or of ``studies``; no other file lists them.

The help shows the meaning of a value (``SERIAL``, ``YYYY-MM-DD``), not its Python type.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass
from datetime import datetime
from functools import reduce, wraps
from importlib import import_module
from importlib.util import find_spec
from inspect import Parameter, Signature, getdoc, signature
from operator import or_
from pathlib import Path
from pkgutil import walk_packages
from typing import Any, Final, TypeVar, get_args, get_origin, get_type_hints

from typer.core import TyperCommand, TyperGroup
from typer.models import ArgumentInfo, OptionInfo

_Run = TypeVar("_Run", bound=Callable[..., Any])

#: Placeholder in help for a value whose option states no other.
_WORDS: Final = {bool: "", str: "TEXT", int: "N", float: "NUMBER", Path: "FILE", datetime: "YYYY-MM-DD"}


@dataclass(frozen=True, slots=True)
class Command:
    """A command.

    Parameters
    ----------
    words : words after ``cbsr-qa``.
    run : function of the command.
    live : whether it prints while it runs.
    reads : module that reads files of unknown origin; empty without one.
    """

    words: str
    run: Callable[..., Any]
    live: bool = False
    reads: str = ""

    @property
    def group(self) -> str:
        """First of two words; empty for a command of one word."""
        return self.words.rpartition(" ")[0]

    @property
    def purpose(self) -> str:
        """Text of its help: paragraphs on one line each, so that the terminal wraps them."""
        paragraphs = (getdoc(self.run) or "").split("\n\n")
        return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)

    @property
    def panel(self) -> str:
        """Heading in the help."""
        return "Studies of many runs or simulations" if ".studies." in self.run.__module__ else "Commands"


#: Commands listed first in help, in the order of use.
_FIRST: Final = ("run", "report", "calibration", "export", "analyse", "station", "verdict", "db")

_COMMANDS: Final[dict[str, Command]] = {}
_GROUPS: Final[dict[str, str]] = {}
_DEFAULTS: Final[dict[str, str]] = {}
_PRINTED: Final[dict[str, str]] = {}


def command(words: str, *, prints: str = "", live: bool = False, reads: str = "") -> Callable[[_Run], _Run]:
    """Declare a command. A parameter that is a dataclass stands for options: one for each of its fields.

    Parameters
    ----------
    words : words of the command line, e.g. ``"db status"``.
    prints : dataclass of its document, or a union of some, e.g. ``"cbsr_qa.app.database:DatabaseStatus"``, imported
        only to print its schema; several are separated by ``|``.
    live : whether it writes to standard output while it runs, by :func:`cbsr_qa.cli.output.live_output`; the output
        of other commands is printed when they have ended.
    reads : module that reads files of unknown origin, if it does: it is imported, and the process that forks the
        children which read them is begun, before anything is open.
    """
    if prints:
        document(words, prints=prints)

    def declare(run: _Run) -> _Run:
        whole = _spread(run)
        # Set a placeholder for every option's value, and an argument's name in capitals.
        for name, info, kind in _parameters(whole):
            if info.metavar is None:
                info.metavar = name.upper() if isinstance(info, ArgumentInfo) else _WORDS[kind]
        _COMMANDS[words] = Command(words, whole, live, reads)
        return run

    return declare


def group(name: str, purpose: str, *, default: str = "") -> None:
    """Declare the purpose of the commands that begin with this word.

    Parameters
    ----------
    default : command that is meant if the second word names none of the group; empty without such a command.
    """
    _GROUPS[name], _DEFAULTS[name] = purpose, default


def document(words: str, *, prints: str) -> None:
    """Declare the dataclass of a document; see :func:`command`."""
    _PRINTED[words] = prints


def commands(first_word: str = "") -> list[Command]:
    """Return all commands: those from run to calibration first, then alphabetically.

    Parameters
    ----------
    first_word : first word of a command line. If a module of that name declares such commands, no other is imported.
    """
    module = f"{__package__}.{first_word}"
    if first_word.isidentifier() and find_spec(module) is not None:
        import_module(module)
    if all(words.partition(" ")[0] != first_word for words in _COMMANDS):
        _import_all()
    rank_by_word = {word: rank for rank, word in enumerate(_FIRST)}
    ranks = {words: rank_by_word.get(words.partition(" ")[0], len(_FIRST)) for words in _COMMANDS}
    return [_COMMANDS[words] for words in sorted(_COMMANDS, key=lambda words: (ranks[words], words))]


def purpose(of_group: str) -> str:
    """Return what a group of commands is for."""
    return _GROUPS[of_group]


def documents() -> dict[str, Any]:
    """Return the dataclass of each document that a command prints, or their union, by the command's words."""
    _import_all()
    kinds = {}
    for words in sorted(_PRINTED):
        places = (place.split(":") for place in _PRINTED[words].split("|"))
        kinds[words] = reduce(or_, (getattr(import_module(module), name) for module, name in places))
    return kinds


def _import_all() -> None:
    package = import_module(__package__)
    for module in walk_packages(package.__path__, f"{__package__}."):
        import_module(module.name)


def _spread(run: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command with a parameter for each field of the dataclasses among its parameters."""
    hints = get_type_hints(run, include_extras=True)
    dataclass_by_name: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    if not dataclass_by_name:
        return run
    spread_parameters: list[Parameter] = []
    for parameter in signature(run).parameters.values():
        spread_parameters += (
            _options_of(dataclass_by_name[parameter.name])
            if parameter.name in dataclass_by_name
            else [parameter.replace(kind=Parameter.KEYWORD_ONLY)]
        )

    @wraps(run)
    def whole(**given: Any) -> Any:
        for name, kind in dataclass_by_name.items():
            given[name] = kind(**{field.name: given.pop(field.name) for field in fields(kind)})
        return run(**given)

    whole.__annotations__ = {parameter.name: parameter.annotation for parameter in spread_parameters}
    vars(whole)["__signature__"] = Signature(spread_parameters)
    return whole


def _options_of(kind: Any) -> list[Parameter]:
    hints = get_type_hints(kind, include_extras=True)
    keyword = Parameter.KEYWORD_ONLY
    return [
        Parameter(option.name, keyword, default=option.default, annotation=hints[option.name])
        for option in fields(kind)
    ]


def _parameters(run: Callable[..., Any]) -> Iterator[tuple[str, ArgumentInfo | OptionInfo, Any]]:
    for name, hint in get_type_hints(run, include_extras=True).items():
        for info in getattr(hint, "__metadata__", ()):
            kind = get_args(hint)[0]
            while get_origin(kind) is not None:  # optional, or given several times
                kind = get_args(kind)[0]
            yield name, info, next(iter(get_args(kind)), kind)


#: Options of typer and of the program itself that take no value.
_FLAGS: Final = ("help", "version", "install_completion", "show_completion")


def _hide_types(parameters: list[Any]) -> list[Any]:
    """Remove types and ranges, which typer adds, from help: descriptions state them."""
    for parameter in parameters:
        parameter._get_number_range_help_str = lambda: None
        if parameter.param_type_name == "argument" or parameter.name in _FLAGS:
            parameter.display_type_rich = lambda ctx: ""
    return parameters


class PlainCommand(TyperCommand):
    """A command whose help shows no Python types."""

    def get_params(self, ctx: Any) -> list[Any]:
        return _hide_types(super().get_params(ctx))


class PlainGroup(TyperGroup):
    """A group of commands whose help shows no Python types."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        default = _DEFAULTS.get(self.name or "")
        if default and args and args[0] not in (*self.commands, "--help"):
            args = [default, *args]
        return super().parse_args(ctx, args)

    def get_params(self, ctx: Any) -> list[Any]:
        return _hide_types(super().get_params(ctx))
