"""``cbsr-qa plugins``: what is installed and from where."""

from typing import Annotated

import typer

from cbsr_qa.cli.output import emit_json, note, say

app = typer.Typer(help="What is installed, and from where.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """What is installed, and from where."""


@app.command("list")
def list_plugins(
    kind: Annotated[str | None, typer.Option(help="Only this kind, e.g. metric.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """List every plugin by kind and name; name those that could not be loaded, with the reason."""
    from cbsr_qa.plugin import discover, kind_named

    plugins = discover()
    found = plugins.registrations(kind_named(kind))
    if as_json:
        rows = [{"kind": str(r.kind), "name": r.name, "from": r.distribution, "version": r.version} for r in found]
        failed = [{"from": f.distribution, "reason": f.reason} for f in plugins.failures]
        emit_json({"plugins": rows, "failed": failed})
        return
    width = max((len(r.name) for r in found), default=0)
    for registration in found:
        source = f"{registration.distribution} {registration.version}"
        say(f"{registration.kind:<15} {registration.name:<{width}}  {source}")
    for failure in plugins.failures:
        note(f"not loaded: {failure.distribution}: {failure.reason}")
