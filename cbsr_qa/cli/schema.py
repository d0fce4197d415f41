"""``cbsr-qa schema``: the JSON Schema of the document that a command prints with ``--json``."""

from collections.abc import Callable
from typing import Annotated, Any, Final

import typer

from cbsr_qa.cli.output import emit_json, say
from cbsr_qa.domain import RefusedError


def _charts() -> type:
    from cbsr_qa.studies.charts import Charts

    return Charts


def _compare() -> type:
    from cbsr_qa.studies.compare import Comparison

    return Comparison


def _gauge() -> type:
    from cbsr_qa.studies.gauge import GaugeStudy

    return GaugeStudy


def _limits() -> type:
    from cbsr_qa.studies.limits import ProposedLimits

    return ProposedLimits


def _reproduce() -> type:
    from cbsr_qa.studies.reproduce import Reproduction

    return Reproduction


def _scene_explain() -> type:
    from cbsr_qa.studies.scenes import Explained

    return Explained


def _scene_run() -> type:
    from cbsr_qa.studies.scenes import SceneRun

    return SceneRun


def _stability() -> type:
    from cbsr_qa.studies.hard_cases import Stability

    return Stability


#: What each command's document is made of; loaded only for the one that is asked for.
RESULTS: Final[dict[str, Callable[[], type]]] = {
    "charts": _charts,
    "compare": _compare,
    "gauge": _gauge,
    "limits": _limits,
    "reproduce": _reproduce,
    "scene-explain": _scene_explain,
    "scene-run": _scene_run,
    "stability": _stability,
}


def schema(
    command: Annotated[str | None, typer.Argument(help="For example gauge; by default list them.")] = None,
) -> None:
    """Print the JSON Schema (draft 2020-12) of what a command prints with --json."""
    if command is None:
        for name in RESULTS:
            say(name)
        return
    emit_json(document_schema(command))


def document_schema(command: str) -> dict[str, Any]:
    """Return the JSON Schema of a command's document.

    Raises
    ------
    RefusedError
        If no schema is known for it.
    """
    from cbsr_qa.report import json_schema

    if command not in RESULTS:
        raise RefusedError(f"no schema for {command!r}", remedy=f"choose one of: {', '.join(RESULTS)}")
    return json_schema(RESULTS[command]())
