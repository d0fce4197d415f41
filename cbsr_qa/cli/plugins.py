"""``cbsr-qa plugins``: what is installed and from where, what each plugin takes; a new one, and its checks."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.command import command, group
from cbsr_qa.cli.options import AsJson
from cbsr_qa.cli.output import show

if TYPE_CHECKING:
    from cbsr_qa.domain.results.report import Section
    from cbsr_qa.plugin.listed import PluginReference

group("plugins", "List, describe, check and start plugins.")


@command("plugins list", prints="cbsr_qa.plugin.listed:ListedPlugins")
def list_plugins(
    kind: Annotated[str | None, typer.Option(help="Only plugins of this kind, e.g. metric.")] = None,
    options: Annotated[bool, typer.Option("--options", help="Say what each does, and list its options.")] = False,
    as_json: AsJson = False,
) -> None:
    """List plugins by kind and name, and those that could not be loaded, with the reason."""
    from dataclasses import replace

    from cbsr_qa.domain.filling import fill_from_object
    from cbsr_qa.domain.results.report import Section
    from cbsr_qa.plugin.discovery import discover
    from cbsr_qa.plugin.hooks import Kind
    from cbsr_qa.plugin.listed import FailedPlugin, ListedPlugin, ListedPlugins
    from cbsr_qa.plugin.software import kind_named
    from cbsr_qa.report.page import answer
    from cbsr_qa.report.tables import plural, text_table

    plugins = discover()
    listed = [
        fill_from_object(ListedPlugin, registration) for registration in plugins.registrations(kind_named(kind))
    ]
    columns: tuple[str, ...] = ("kind", "name", "from")
    rows = [[plugin.kind, plugin.name, f"{plugin.distribution} {plugin.version}"] for plugin in listed]
    if options:
        from cbsr_qa.plugin.reference import plugin_reference

        references = [plugin_reference(plugins, Kind(plugin.kind), plugin.name) for plugin in listed]
        listed = [
            replace(plugin, options=reference.options, summary=reference.summary)
            for plugin, reference in zip(listed, references, strict=True)
        ]
        columns += ("what it does", "options")
        rows = [
            [*row, reference.summary, ", ".join(option.name for option in reference.options)]
            for row, reference in zip(rows, references, strict=True)
        ]
    failed = tuple(fill_from_object(FailedPlugin, failure) for failure in plugins.failures)
    warnings = [f"not loaded: {failure.distribution}: {failure.reason}" for failure in failed]
    table = text_table("By kind and name.", columns, rows)
    outcome = answer(ListedPlugins(tuple(listed), failed), plural(len(listed), "plugin"), warnings=warnings)
    show(replace(outcome, sections=(Section("Installed", (table,)),)), as_json=as_json)


@command("plugins show", prints="cbsr_qa.plugin.listed:ShownPlugins")
def show_plugin(
    name: Annotated[str, typer.Argument(help="Name of the plugin.")],
    kind: Annotated[str | None, typer.Option(help="Only plugins of this kind, e.g. metric.")] = None,
    as_json: AsJson = False,
) -> None:
    """Show the options of a plugin, with unit, default and range, and what it measures."""
    from dataclasses import replace

    from cbsr_qa.plugin.discovery import discover
    from cbsr_qa.plugin.hooks import Kind
    from cbsr_qa.plugin.listed import ShownPlugins
    from cbsr_qa.plugin.reference import plugin_reference
    from cbsr_qa.plugin.software import kind_named
    from cbsr_qa.report.page import answer

    plugins = discover()
    asked_kind = kind_named(kind)
    kinds = [
        plugin_kind
        for plugin_kind in Kind
        if asked_kind in (None, plugin_kind) and name in plugins.names(plugin_kind)
    ]
    references = tuple(plugin_reference(plugins, plugin_kind, name) for plugin_kind in kinds)
    if not references:
        raise plugins.unknown(asked_kind, name)
    kinds_text = " and ".join(
        f"{'an' if plugin.kind[0] in 'aeiou' else 'a'} {plugin.kind} plugin" for plugin in references
    )
    outcome = answer(ShownPlugins(references), f"{name} is {kinds_text}")
    show(replace(outcome, sections=tuple(map(_section, references))), as_json=as_json)


@command("plugins new", prints="cbsr_qa.testing.kit.new:NewPackage")
def new_plugin(
    kind: Annotated[str, typer.Argument(help="What it adds, e.g. metric.")],
    name: Annotated[str, typer.Argument(help="Name of the plugin: lower-case words joined by hyphens.")],
    into: Annotated[
        Path, typer.Option(help="Folder in which the package's folder is made.", metavar="FOLDER")
    ] = Path(),
    as_json: AsJson = False,
) -> None:
    """Write a package with one working plugin to start from: code, test, README and pyproject.toml."""
    from cbsr_qa.plugin.discovery import discover
    from cbsr_qa.plugin.software import kind_named
    from cbsr_qa.report.page import answer
    from cbsr_qa.testing.kit.new import make_package

    plugin_kind = kind_named(kind)
    assert plugin_kind is not None  # None stands for all kinds only where no kind is given
    package = make_package(plugin_kind, name, discover(), into)
    # In the form for pip, which would look for a bare name on the net.
    folder = str(package.folder) if package.folder.is_absolute() else f"./{package.folder}"
    printed = (
        *(("file", str(package.folder / file)) for file in package.files),
        ("change", str(package.folder / package.module / f"{package.kind}.py")),
        ("check", f"cbsr-qa plugins check {package.folder}/"),
        ("install", f"python -m pip install --no-deps {folder}"),
    )
    show(answer(package, f"{package.folder} has the {package.kind} {package.name}", printed=printed), as_json=as_json)


@command("plugins check", prints="cbsr_qa.testing.kit.conformance:CheckedPlugins")
def check_plugin(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Name of a plugin, or folder of a package, installed or not; default: all of other packages."
        ),
    ] = None,
    kind: Annotated[str | None, typer.Option(help="Only plugins of this kind, e.g. metric.")] = None,
    as_json: AsJson = False,
) -> int:
    """Check a plugin with the test kit, and say what to change where it fails.

    Exit code 0: all checks that apply passed. 1: a check failed. 2: the plugin cannot be found or loaded.
    """
    from cbsr_qa.cli.output import Counting
    from cbsr_qa.plugin.software import kind_named
    from cbsr_qa.testing.kit.conformance import check_plugins
    from cbsr_qa.testing.kit.package import targets_of
    from cbsr_qa.testing.kit.report import checks_outcome

    targets = targets_of(name, kind_named(kind))
    with Counting("checks") as counting:
        return show(checks_outcome(check_plugins(targets, counting.stage)), as_json=as_json)


def _section(plugin: "PluginReference") -> "Section":
    from cbsr_qa.domain.results.report import Block, Paragraph, Section
    from cbsr_qa.report.tables import text_table

    blocks: list[Block] = [Paragraph(_strip_markup(plugin.summary))]
    if plugin.measures:
        rows = [(name, unit) for name, unit in plugin.measures.items()]
        blocks.append(text_table("Measurements.", ("measurement", "unit"), rows))
    if plugin.options:
        options = [
            (o.name, o.unit, "required" if o.required else o.default, o.allowed, _strip_markup(o.description))
            for o in plugin.options
        ]
        blocks.append(
            text_table(
                "Options.",
                ("option", "unit", "default", "allowed", "meaning"),
                options,
            )
        )
    else:
        blocks.append(Paragraph("It has no options."))
    return Section(f"{plugin.kind.capitalize()} {plugin.name}", tuple(blocks))


def _strip_markup(text: str) -> str:
    """Take the markup of docstrings out: roles such as :class: and back-quotes."""
    return re.sub(r":\w+:(?=`)|`", "", text).replace("~", "")
