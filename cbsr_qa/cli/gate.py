"""``cbsr-qa gate``, ``release`` and ``station pin``: what the checks before a run say, and what they rest on."""

from dataclasses import dataclass
from typing import Annotated

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import AsJson, Database
from cbsr_qa.cli.output import read_pin, show
from cbsr_qa.domain.errors import ConfigError


@command("gate", prints="cbsr_qa.app.gate.shown:GateShown")
def gate(
    station: Annotated[str, typer.Option(help="Station file, or the name of a shipped one.")],
    recipe: Annotated[str, typer.Option(help="Recipe file, or the name of a shipped one.")],
    serial: Annotated[str, typer.Option(help="Serial number of the sensor.")],
    batch: Annotated[str, typer.Option(help="Material batch of the sensor.")] = "",
    operator: Annotated[str, typer.Option(help="Name of the operator.")] = "",
    sensor_type: Annotated[str | None, typer.Option(help="Sensor type; by default the station's.")] = None,
    material: Annotated[str | None, typer.Option(help="Material; by default the station's.")] = None,
    database: Database = None,
    as_json: AsJson = False,
) -> int:
    """Show the results of the checks before a run, without starting it; asks for no PIN.

    Exit code 0 if the run could begin, 2 if a check refuses it.
    """
    from cbsr_qa.app.run.run import RunRequest, preview_gate

    request = RunRequest(
        station=station,
        recipe=recipe,
        serial=serial,
        batch=batch,
        operator=operator,
        sensor_type=sensor_type,
        material=material,
        database=database,
    )
    return show(preview_gate(request), as_json=as_json)


@command("release", prints="cbsr_qa.app.gate.releases:Released")
def release(
    file: Annotated[
        str,
        typer.Argument(help="Station, recipe, sensor type, material or scene file, or the name of a shipped one."),
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


@dataclass(frozen=True, slots=True)
class PinLine:
    """A salted hash of a PIN, as the key ``pin`` of an operator in the station file."""

    pin: str


@command("station pin", prints="cbsr_qa.cli.gate:PinLine")
def pin(as_json: AsJson = False) -> None:
    """Ask for a PIN and print its salted hash, a line for the operator in the station file.

    The PIN is typed twice at the terminal, or read from the first line of standard input.
    """
    import sys

    from cbsr_qa.report.page import answer
    from cbsr_qa.system.pins import hash_pin, pin_allowed

    given = read_pin("New PIN")
    if not pin_allowed(given):
        remedy = "allowed: 4 to 64 printable characters, without a space at either end"
        raise ConfigError("the PIN cannot be used", remedy=remedy)
    if sys.stdin is not None and sys.stdin.isatty() and read_pin("The same PIN again") != given:
        raise ConfigError("the two PINs differ", remedy="try again")
    line = PinLine(hash_pin(given))
    show(
        answer(line, "add this to the operator's [[gate.operators]] table", "", (), (("pin", f'= "{line.pin}"'),)),
        as_json=as_json,
    )
