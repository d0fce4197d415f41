"""Plugins that a configuration file names: their options are checked with the rest of the file, in one pass."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import Any

from cbsr_qa.domain.errors import CbsrError, PluginError
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.failures import blame_plugin
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.options import options_of
from cbsr_qa.plugin.problems import Problem, check
from cbsr_qa.system.words import KeyPath, quote_value

#: Plugins that are made of their options alone; the others need a bench or a scene.
_MADE_OF_OPTIONS = (Kind.SEQUENCE, Kind.RECONSTRUCTION, Kind.METRIC, Kind.SINK)


@dataclass(frozen=True, slots=True)
class Choice:
    """A plugin that a file names.

    Parameters
    ----------
    path : key path of the table with its options.
    named : key path of its name, where that is not the table's own.
    """

    kind: Kind
    name: str
    path: KeyPath
    options: Mapping[str, Any] = field(default_factory=dict)
    named: KeyPath = ()


def tables(data: Any, key: str) -> Iterator[tuple[int, Mapping[str, Any]]]:
    """Yield the tables of an array of tables with their index; other items are skipped."""
    content = data.get(key) if isinstance(data, Mapping) else None
    for index, table in enumerate(content if isinstance(content, list) else ()):
        if isinstance(table, Mapping):
            yield index, table


def read_choice(kind: Kind, table: Any, path: KeyPath, key: str, known: Sequence[str] = ()) -> Iterator[Choice]:
    """Yield the plugin that a table names under a key; its options are the keys outside ``known``."""
    name = table.get(key) if isinstance(table, Mapping) else None
    if isinstance(name, str):
        options = {k: value for k, value in table.items() if k not in (key, *known)}
        yield Choice(kind, name, path, options, (*path, key))


def check_choice(choice: Choice, plugins: Plugins) -> tuple[object, list[Problem]]:
    """Check the options of a plugin, and make the plugin if it needs nothing else.

    Returns
    -------
    The plugin (its factory where it was not made, None without one), and what is wrong.
    """
    try:
        factory = plugins.factory(choice.kind, choice.name)
    except PluginError as error:
        path = choice.named or choice.path
        name = "" if choice.name == path[-1] else f"{quote_value(choice.name)}, "
        unknown = choice.name not in plugins.names(choice.kind)
        reason = f"is {name}no installed {choice.kind} plugin" if unknown else f"cannot be used: {error.reason}"
        return None, [Problem(path, reason, error.remedy)]
    if choice.kind is Kind.INSTRUMENT and not hasattr(factory, "Options"):
        return factory, []  # the driver checks its table itself
    _, problems = check(options_of(factory, handed=int(choice.kind is Kind.EFFECT)), choice.options)
    if problems or choice.kind not in _MADE_OF_OPTIONS:
        return factory, [replace(problem, path=(*choice.path, *problem.path)) for problem in problems]
    try:
        with blame_plugin(f"{choice.kind} {choice.name!r}"):
            return factory(**choice.options), []
    except CbsrError as error:
        return factory, [Problem(choice.path, f"cannot be used: {error.reason}", error.remedy)]


def check_measured(
    limits: Iterator[tuple[int, Mapping[str, Any]]], measured: Mapping[str, str], *, all_known: bool
) -> Iterator[Problem]:
    """Yield limits on quantities that nothing measures, or in another unit than theirs.

    Parameters
    ----------
    measured : names of measurements and their units.
    all_known : whether these are all measurements.
    """
    for index, limit in limits:
        name, unit = limit.get("measurement"), limit.get("unit")
        if not isinstance(name, str) or not isinstance(unit, str):
            continue
        if name not in measured and all_known:
            close_matches = get_close_matches(name, measured, n=1)
            hint = f"did you mean {close_matches[0]!r}? " if close_matches else ""
            finding = f"is {quote_value(name)}, which no metric of this recipe measures"
            yield Problem(("limits", index, "measurement"), finding, f"{hint}measured: {', '.join(sorted(measured))}")
        elif name in measured and unit != measured[name]:
            rule = f"it must be {measured[name]!r}, the unit that {name} is measured in"
            yield Problem(("limits", index, "unit"), f"is {quote_value(unit)}", rule)
