"""Checks of plugins, one by one: each has a rule and a remedy, which its docstring states."""

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from inspect import cleandoc, getdoc
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

from cbsr_qa.plugin import ConfigError, Example, Kind, options_of
from cbsr_qa.plugin.discovery import Factory, Plugins
from cbsr_qa.plugin.failures import failure
from cbsr_qa.plugin.reference import plugin_reference
from cbsr_qa.testing.checked import Checked
from cbsr_qa.testing.kit.kinds import CHECKS_OF, Check, Subject
from cbsr_qa.testing.kit.package import Targets, targets_of

_NAME: Final = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_UNKNOWN: Final = "an_option_that_no_plugin_has"


class CheckOutcome(StrEnum):
    """What came of a check."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_APPLICABLE = "not applicable"


@dataclass(frozen=True, slots=True)
class PluginCheck:
    """One check of one plugin.

    Parameters
    ----------
    found : what the plugin did; why the check does not apply.
    allowed : the rule.
    remedy : what to change; empty unless it failed.
    """

    kind: str
    name: str
    check: str
    outcome: CheckOutcome
    found: str
    allowed: str
    remedy: str


@dataclass(frozen=True, slots=True)
class CheckedPlugins:
    """All checks of plugins, in the order in which they were made, and how many failed."""

    checks: tuple[PluginCheck, ...]
    passed: int
    failed: int


def check_plugins(targets: Targets, progress: Callable[[str], None] = lambda stage: None) -> CheckedPlugins:
    """Make every check that applies to plugins.

    Parameters
    ----------
    progress : called with the name of each plugin before its checks.
    """
    lines: list[PluginCheck] = []
    for kind, name in targets.names:
        progress(f"checking {kind} {name}")
        for check in _checks(targets.plugins, kind, name):
            lines += carry_out(kind, name, check)
    failed = sum(check.outcome is CheckOutcome.FAILED for check in lines)
    passed = sum(check.outcome is CheckOutcome.PASSED for check in lines)
    return CheckedPlugins(tuple(lines), passed, failed)


def assert_conforms(asked: str | Path) -> None:
    """Check the plugins of a package's folder, or one by name, as ``cbsr-qa plugins check`` does.

    Raises
    ------
    AssertionError
        Listing the checks that failed: what was found, what is allowed, and the remedy.
    """
    checked = check_plugins(targets_of(str(asked)))
    failed = [check for check in checked.checks if check.outcome is CheckOutcome.FAILED]
    assert not failed, "\n\n".join(describe_check(check) for check in failed)
    assert checked.passed, f"no check was made of {asked}"


def describe_check(check: PluginCheck) -> str:
    """Return a failed check in words, a line each."""
    return (
        f"{check.kind} {check.name}: {check.check}\n"
        f"found: {check.found}\nallowed: {check.allowed}\nremedy: {check.remedy}"
    )


def documentation_checks(plugins: Plugins, kind: Kind, name: str) -> tuple[partial[Checked], ...]:
    """Return the checks of names and documentation, which need no instance of the plugin."""
    return (
        partial(check_name, name),
        partial(check_documentation, plugins, kind, name),
        partial(check_unknown_option, plugins.factory(kind, name), kind),
        partial(check_hooks, plugins, kind, name),
    )


def _checks(plugins: Plugins, kind: Kind, name: str) -> Iterator[Check]:
    loaded = partial(check_import, plugins, kind, name)
    yield loaded
    try:
        factory = plugins.factory(kind, name)
    except BaseException:  # noqa: BLE001 - reported by the check above
        return
    yield from documentation_checks(plugins, kind, name)
    answer: list[Example] = []
    yield partial(check_example, plugins, kind, name, answer)
    if not answer:
        return
    with closing(SimpleNamespace(close=answer[0].close)):
        subject = Subject(plugins, kind, name, factory, answer[0])
        try:
            yield from CHECKS_OF[kind](subject)
        except Exception as error:  # noqa: BLE001 - a plugin's code may raise anything
            yield partial(check_creation, error)


def check_import(plugins: Plugins, kind: Kind, name: str) -> Checked:
    """The module of the plugin can be imported, and has the factory.

    Remedy: repair the module; compare it with the target in ``register``.
    """
    factory = plugins.factory(kind, name)
    return Checked("import", f"{factory.__module__}:{getattr(factory, '__qualname__', name)}")


def check_name(name: str) -> Checked:
    """A name is lower-case words of letters and digits, joined by hyphens.

    Remedy: change the name in ``register``.
    """
    assert _NAME.fullmatch(name), f"the name {name!r}"
    return Checked("name", name)


def check_documentation(plugins: Plugins, kind: Kind, name: str) -> Checked:
    """The docstring says in its first paragraph what the plugin does, and has a line for each option.

    Remedy: add the missing lines to the docstring, ``option_name : what it means.`` each.
    """
    reference = plugin_reference(plugins, kind, name)
    missing = [option.name for option in reference.options if not option.description]
    has_docstring = bool(vars(plugins.factory(kind, name)).get("__doc__"))
    lacks = [*([] if has_docstring else ["the plugin"]), *(f"option {option}" for option in missing)]
    assert not lacks, f"no description of {', '.join(lacks)}"
    return Checked(
        "documentation",
        "summary"
        + ("; options: " + ", ".join(option.name for option in reference.options)) * bool(reference.options),
    )


def check_unknown_option(factory: Factory, kind: Kind) -> Checked:
    """An option that does not exist is refused.

    Remedy: declare the options in a model ``Options``, or as keyword arguments without ``**``.
    """
    model = options_of(factory, handed=int(kind in (Kind.EFFECT, Kind.INSTRUMENT)))
    try:
        model.read({_UNKNOWN: 1})
    except ConfigError as error:
        refusal = error.reason
    else:
        raise AssertionError("any option is accepted, so a misspelt one would go unnoticed")
    assert _UNKNOWN in refusal, f"the refusal does not name it: {refusal}"
    return Checked("unknown option", "refused, and the message names it")


def check_hooks(plugins: Plugins, kind: Kind, name: str) -> Checked:
    """Each hook that the distribution implements exists, and its function has a docstring.

    Remedy: correct the name of the hook (the page "Hooks" of the documentation lists them), and say in its docstring
    what it does.
    """
    (registration,) = (r for r in plugins.registrations(kind) if r.name == name)
    functions = [
        (hook, getattr(module, hook))
        for label, module in plugins.manager.list_name_plugin()
        if label.startswith(f"{registration.distribution}:")
        for hook in dir(module)
        if hasattr(getattr(module, hook), f"{plugins.manager.project_name}_impl")
    ]
    unknown = [hook for hook, _ in functions if not getattr(plugins.manager.hook, hook).has_spec()]
    assert not unknown, f"no such hook: {', '.join(unknown)}"
    silent = [hook for hook, function in functions if not getdoc(function)]
    assert not silent, f"no docstring: {', '.join(silent)}"
    return Checked("hooks", ", ".join(hook for hook, _ in functions))


def check_example(plugins: Plugins, kind: Kind, name: str, answer: list[Example]) -> Checked:
    """The hook cbsr_example gives what is needed to try the plugin, and its options are accepted.

    Remedy: implement ``cbsr_example`` beside ``cbsr_register`` and return an ``Example`` with valid options; for an
    instrument with the address of its emulator.
    """
    example = plugins.example(kind, name)
    if example is None:
        assert kind is not Kind.INSTRUMENT, "no example: it is not opened, because it could be a real instrument"
        example = Example()
    assert isinstance(example, Example), f"{example!r}, which is no Example"
    factory = plugins.factory(kind, name)
    try:
        options_of(factory, handed=int(kind in (Kind.EFFECT, Kind.INSTRUMENT))).read(example.options)
    except ConfigError as error:
        example.close()
        raise AssertionError(f"{error.reason}; {error.remedy}" if error.remedy else error.reason) from error
    answer.append(example)
    return Checked("example", f"options {dict(example.options)}" if example.options else "default options")


def check_creation(error: Exception) -> Checked:
    """The plugin can be created with the options of its example.

    Remedy: repair its creation; ``cbsr_example`` gives the options.
    """
    raise error


def carry_out(kind: Kind, name: str, check: Check) -> Iterable[PluginCheck]:
    """Make a check; whatever it raises is a failure with rule and remedy."""
    rule, remedy = _rule(check)
    try:
        results = check()
    except BaseException as error:
        if not isinstance(error, Exception | SystemExit):
            raise
        what = str(error) if isinstance(error, AssertionError) else failure(error)
        check_name = _function(check).__name__.removeprefix("check_").replace("_", " ")
        return [PluginCheck(kind, name, check_name, CheckOutcome.FAILED, what, rule, remedy)]
    return [
        PluginCheck(
            kind,
            name,
            result.check,
            CheckOutcome.PASSED if result.applies else CheckOutcome.NOT_APPLICABLE,
            result.found,
            rule,
            "",
        )
        for result in (results if isinstance(results, tuple) else (results,))
    ]


def _function(check: Check) -> Callable[..., Any]:
    return check.func if isinstance(check, partial) else check


def _rule(check: Check) -> tuple[str, str]:
    """Return what a check allows, and its remedy, both from its docstring."""
    paragraphs = [" ".join(p.split()) for p in cleandoc(_function(check).__doc__ or "").split("\n\n")]
    remedy = next((p.removeprefix("Remedy: ") for p in paragraphs if p.startswith("Remedy: ")), "")
    rule = re.sub(r"^Check (that |(an?|the) [^:]*: )", "", paragraphs[0])
    return rule[:1].upper() + rule[1:], re.sub("`+", "", remedy)
