"""``cbsr-qa schema``: the JSON Schema of what a command prints with ``--json``, of events and of channels."""

from typing import Annotated, Any

import typer

from cbsr_qa.cli.command import command, document, documents
from cbsr_qa.cli.output import emit_json, say
from cbsr_qa.domain.errors import RefusedError

document("events", prints="cbsr_qa.domain.run.event_documents:EventMessage")
document("channel", prints="cbsr_qa.station.control.messages:ChannelLine")


@command("schema")
def schema(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="COMMAND", help="e.g. gauge, db status, events, channel or stream messages; without it, list all."
        ),
    ] = None,
) -> None:
    """Print the JSON Schema (draft 2020-12) of what a command prints with --json, of events, channels or streams."""
    if not words:
        for name in documents():
            say(name)
        return
    emit_json(document_schema(" ".join(words).replace("-", " ")))


def document_schema(words: str) -> dict[str, Any]:
    """Return the JSON Schema of a command's document. RefusedError if the command has none."""
    from cbsr_qa.report.document import json_schema

    kind_by_words = documents()
    chosen = [name for name in kind_by_words if name == words] or [
        name for name in kind_by_words if name.startswith(f"{words} ")
    ]
    if len(chosen) == 1:  # "limits" is enough for the only command that begins so
        return json_schema(kind_by_words[chosen[0]])
    raise RefusedError(f"no schema for {words!r}", remedy=f"choose one of: {', '.join(chosen or kind_by_words)}")
