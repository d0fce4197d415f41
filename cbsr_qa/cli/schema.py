"""``cbsr-qa schema``: the JSON Schema of the document that a command prints with ``--json``."""

from typing import Annotated, Any

import typer

from cbsr_qa.cli.output import emit_json, say
from cbsr_qa.domain import RefusedError


def results() -> dict[str, type]:
    """Return the dataclass of each command's document."""
    from cbsr_qa.app import (
        AppliedCalibration,
        Changes,
        Converted,
        DatabaseStatus,
        Exported,
        Overridden,
        ShownCalibration,
        SoundFile,
        Upgrade,
    )
    from cbsr_qa.app.analyse import Analysed
    from cbsr_qa.app.run import PlannedRun, Rendered, RunOutcome
    from cbsr_qa.app.station_check import CheckedStation
    from cbsr_qa.plugin import ListedPlugins, ShownPlugins
    from cbsr_qa.studies.charts import Charts
    from cbsr_qa.studies.compare import Comparison
    from cbsr_qa.studies.frontier import Frontier
    from cbsr_qa.studies.gauge import GaugeStudy
    from cbsr_qa.studies.hard_cases import Stability
    from cbsr_qa.studies.limits import ProposedLimits
    from cbsr_qa.studies.reproduce import Reproduction
    from cbsr_qa.studies.scenes import Explained, SceneRun

    return {
        "analyse": Analysed,
        "calibration apply": AppliedCalibration,
        "calibration export": Converted,
        "calibration show": ShownCalibration,
        "calibration verify": SoundFile,
        "charts": Charts,
        "compare": Comparison,
        "db changes": Changes,
        "db status": DatabaseStatus,
        "db upgrade": Upgrade,
        "dry run": PlannedRun,
        "export": Exported,
        "frontier": Frontier,
        "gauge": GaugeStudy,
        "limits": ProposedLimits,
        "plugins list": ListedPlugins,
        "plugins show": ShownPlugins,
        "report": Rendered,
        "reproduce": Reproduction,
        "run": RunOutcome,
        "scene explain": Explained,
        "scene run": SceneRun,
        "stability": Stability,
        "station check": CheckedStation,
        "verdict override": Overridden,
    }


def schema(
    command: Annotated[
        list[str] | None, typer.Argument(help="Command, e.g. gauge or db status; without it, list all.")
    ] = None,
) -> None:
    """Print the JSON Schema (draft 2020-12) of what a command prints with --json."""
    if not command:
        for name in results():
            say(name)
        return
    emit_json(document_schema(" ".join(command).replace("-", " ")))


def document_schema(command: str) -> dict[str, Any]:
    """Return the JSON Schema of a command's document. RefusedError if the command has none."""
    from cbsr_qa.report import json_schema

    known = results()
    if command not in known:
        raise RefusedError(f"no schema for {command!r}", remedy=f"choose one of: {', '.join(known)}")
    return json_schema(known[command])
