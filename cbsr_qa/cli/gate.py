"""``cbsr-qa gate``, ``release`` and ``releases``: what the checks before a run say, and what they rest on."""

from typing import Annotated

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import AsJson, Database, Parts
from cbsr_qa.cli.output import show


@command("gate", prints="cbsr_qa.app.gate.shown:GateShown")
def gate(
    station: Annotated[str, typer.Option(help="Station file, or the name of a shipped one.")],
    recipe: Annotated[str, typer.Option(help="Recipe file, or the name of a shipped one.")],
    serial: Annotated[str, typer.Option(help="Serial number of the sensor.")],
    batch: Annotated[str, typer.Option(help="Material batch of the sensor.")] = "",
    part: Parts = None,
    operator: Annotated[str, typer.Option(help="Name of the operator.")] = "",
    sensor_type: Annotated[str | None, typer.Option(help="Sensor type; by default the station's.")] = None,
    material: Annotated[str | None, typer.Option(help="Material; by default the station's.")] = None,
    database: Database = None,
    as_json: AsJson = False,
) -> int:
    """Show the results of the checks before a run, without starting it; asks for no PIN.

    Exit code 0 if the run could begin, 2 if a check refuses it.
    """
    from cbsr_qa.app.run.preview import preview_gate
    from cbsr_qa.app.run.request import RunRequest
    from cbsr_qa.config.serials import read_parts

    request = RunRequest(
        station=station,
        recipe=recipe,
        serial=serial,
        batch=batch,
        operator=operator,
        sensor_type=sensor_type,
        material=material,
        database=database,
        parts=read_parts(part or ()),
    )
    return show(preview_gate(request), as_json=as_json)


@command("release", prints="cbsr_qa.app.gate.releases:Released")
def release(
    file: Annotated[
        str,
        typer.Argument(
            help="Station, recipe, sensor type, material or scene file, or a shipped one's name; or a batch's model."
        ),
    ],
    by: Annotated[str, typer.Option(metavar="NAME", help="Who releases it.")],
    why: Annotated[str, typer.Option(metavar="TEXT", help="Reason.")],
    withdraw: Annotated[bool, typer.Option("--withdraw", help="Withdraw the release of this content.")] = False,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Release a file for runs at stations that require it: stores the digest of its content, with who and why.

    Comments and the order of keys do not matter; any other change needs a release of its own.
    """
    from cbsr_qa.app.gate.releases import ReleaseRequest, release_file

    show(release_file(ReleaseRequest(file, by, why, withdraw, database)), as_json=as_json)


@command("releases", prints="cbsr_qa.app.gate.release_list:ReleaseList")
def releases(database: Database = None, as_json: AsJson = False) -> None:
    """List which files were released or withdrawn, by whom, when and why; the latest entry for a content counts."""
    from cbsr_qa.app.gate.release_list import list_releases

    raise typer.Exit(show(list_releases(database), as_json=as_json))
