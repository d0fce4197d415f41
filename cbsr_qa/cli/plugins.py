"""``cbsr-qa plugins``: what is installed and from where."""

from dataclasses import dataclass
from typing import Annotated

import typer
from pydantic import Field

from cbsr_qa.cli.options import AsJson
from cbsr_qa.cli.output import show

app = typer.Typer(help="List what is installed, and from where.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """List what is installed, and from where."""


@dataclass(frozen=True, slots=True)
class Plugin:
    """A registered plugin and the distribution it comes from."""

    kind: str
    name: str
    distribution: Annotated[str, Field(serialization_alias="from")]
    version: str


@dataclass(frozen=True, slots=True)
class FailedPlugin:
    """A distribution whose plugins could not be loaded."""

    distribution: Annotated[str, Field(serialization_alias="from")]
    reason: str


@dataclass(frozen=True, slots=True)
class ListedPlugins:
    """Plugins by kind and name, and those that could not be loaded."""

    plugins: tuple[Plugin, ...]
    failed: tuple[FailedPlugin, ...]


@app.command("list")
def list_plugins(
    kind: Annotated[str | None, typer.Option(help="Only this kind, e.g. metric.")] = None,
    as_json: AsJson = False,
) -> None:
    """List every plugin by kind and name; name those that could not be loaded, with the reason."""
    from dataclasses import replace

    from cbsr_qa.domain.results import Section
    from cbsr_qa.plugin import discover, kind_named
    from cbsr_qa.report import answer, filled, plural, text_table

    plugins = discover()
    found = tuple(filled(Plugin, one) for one in plugins.registrations(kind_named(kind)))
    failed = tuple(filled(FailedPlugin, one) for one in plugins.failures)
    warnings = [f"not loaded: {one.distribution}: {one.reason}" for one in failed]
    rows = [(one.kind, one.name, f"{one.distribution} {one.version}") for one in found]
    table = text_table("By kind and name.", ("kind", "name", "from"), rows)
    outcome = answer(ListedPlugins(found, failed), plural(len(found), "plugin"), warnings=warnings)
    show(replace(outcome, sections=(Section("Installed", (table,)),)), as_json=as_json)
