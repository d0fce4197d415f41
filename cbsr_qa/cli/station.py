"""``cbsr-qa station``: looks after a station."""

import getpass
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command, group
from cbsr_qa.cli.options import AsJson, Database
from cbsr_qa.cli.output import announce, read_pin, show
from cbsr_qa.domain.errors import ConfigError, RefusedError

group("station", "Check stations, and pause or stop the runs at them.")


@command("station check", prints="cbsr_qa.app.station_check.outcome:CheckedStation")
def check(
    context: typer.Context,
    station: Annotated[
        str, typer.Option(help="Station file, or the name of a shipped one, as for cbsr-qa run. Required.")
    ] = "",
    named: Annotated[
        str, typer.Argument(metavar="STATION", show_default=False, help="Shorter for --station STATION.")
    ] = "",
    golden: Annotated[
        str | None, typer.Option(metavar="SERIAL", help="Golden sensor to run and compare with its earlier runs.")
    ] = None,
    operator: Annotated[str, typer.Option(help="Name of the operator.")] = "",
    ring_ohm: Annotated[
        float | None,
        typer.Option(
            metavar="OHM", help="Resistance of each resistor of the reference ring; by default the station file's."
        ),
    ] = None,
    ring: Annotated[
        bool,
        typer.Option(show_default=False, help="Measure the reference ring; by default if its resistances are known."),
    ] = True,
    ring_connected: Annotated[
        bool, typer.Option("--ring-connected", help="The ring is already connected; do not ask.")
    ] = False,
    sensor_type: Annotated[str | None, typer.Option(help="Sensor type; by default the station's.")] = None,
    material: Annotated[str | None, typer.Option(help="Material; by default the station's.")] = None,
    seed: Annotated[int, typer.Option(help="Seed for simulated instruments.", min=0, max=2**31 - 1)] = 0,
    replay: Annotated[
        Path | None,
        typer.Option(metavar="TRANSCRIPT", help="Let a transcript answer for the instruments; stores nothing."),
    ] = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Test every instrument, measure a reference ring, run a golden sensor; store and show the result.

    Exit code 1 if a check failed, 3 if no instrument answered.
    """
    if bool(station) == bool(named):
        context.fail("The station is named twice: leave --station out." if station else "Missing option '--station'.")
    if replay is not None and golden is not None:
        context.fail("--golden runs a sensor, which a transcript cannot: leave out --golden or --replay.")
    from cbsr_qa.app.station_check.check import check_station, replay_check
    from cbsr_qa.app.station_check.request import CheckRequest
    from cbsr_qa.cli.console import Terminal

    request = CheckRequest(
        station=station or named,
        golden=golden,
        operator=operator,
        ring_ohm=ring_ohm,
        ring=ring,
        ring_connected=ring_connected,
        sensor_type=sensor_type,
        material=material,
        seed=seed,
        database=database,
    )
    console = Terminal(database)
    checked = check_station(request, console) if replay is None else replay_check(request, replay, console)
    raise typer.Exit(show(checked, as_json=as_json))


@command("station record", prints="cbsr_qa.app.station_check.outcome:CheckedStation")
def record(
    station: Annotated[str, typer.Argument(help="Station file, or the name of a shipped one.")],
    to: Annotated[Path, typer.Option("--to", metavar="TRANSCRIPT", help="File to write; must not exist yet.")],
    operator: Annotated[str, typer.Option(help="Name of the operator.")] = "",
    ring_ohm: Annotated[
        float | None, typer.Option(metavar="OHM", help="Resistance of each resistor of the reference ring.")
    ] = None,
    ring: Annotated[
        bool,
        typer.Option(show_default=False, help="Measure the reference ring; by default if its resistances are known."),
    ] = True,
    ring_connected: Annotated[
        bool, typer.Option("--ring-connected", help="The ring is already connected; do not ask.")
    ] = False,
    sensor_type: Annotated[str | None, typer.Option(help="Sensor type; by default the station's.")] = None,
    material: Annotated[str | None, typer.Option(help="Material; by default the station's.")] = None,
    seed: Annotated[int, typer.Option(help="Seed for simulated instruments.", min=0, max=2**31 - 1)] = 0,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Check a station, and keep every byte between drivers and instruments in a text file.

    cbsr-qa station check STATION --replay TRANSCRIPT makes the same check without the instruments. Exit code 1 also
    if the file is not whole.
    """
    from cbsr_qa.app.station_check.check import check_station
    from cbsr_qa.app.station_check.request import CheckRequest
    from cbsr_qa.cli.console import Terminal

    request = CheckRequest(
        station=station,
        operator=operator,
        ring_ohm=ring_ohm,
        ring=ring,
        ring_connected=ring_connected,
        sensor_type=sensor_type,
        material=material,
        seed=seed,
        database=database,
        record=to,
    )
    raise typer.Exit(show(check_station(request, Terminal(database)), as_json=as_json))


Named = Annotated[str, typer.Argument(metavar="NAME", help="Station, by the name in its file.")]
By = Annotated[str, typer.Option(metavar="NAME", help="Who asks for it; stored with the run.")]


@command("station pause")
def pause(station: Named, by: By = "") -> None:
    """Pause the run at a station before its next press, with the head up."""
    _request(station, "pause", by)
    announce("the run pauses before its next press; cbsr-qa station continue lets it go on")


@command("station continue")
def resume(station: Named, by: By = "") -> None:
    """Continue a paused run, or withdraw the request for a pause."""
    _request(station, "continue", by)
    announce("the run continues")


@command("station stop")
def stop(
    station: Named,
    by: By = "",
    at_once: Annotated[
        bool, typer.Option("--at-once", help="Do not lift the head first: make the bench safe at once.")
    ] = False,
) -> None:
    """Stop the run at a station: the current step is completed, the head is lifted, the bench is made safe."""
    _request(station, "emergency" if at_once else "stop", by)
    announce("the bench is made safe at once" if at_once else "the run stops, and the head is lifted")


@command("station confirm")
def confirm(
    station: Named,
    by: Annotated[str, typer.Option(metavar="NAME", help="Who has looked at the bench.")],
    database: Database = None,
) -> None:
    """Confirm that the bench is safe after an emergency stop: before that, no run begins at its station."""
    from cbsr_qa.app.run.control import confirm_bench, find_unconfirmed_stop
    from cbsr_qa.config.paths import database_url
    from cbsr_qa.config.serials import validate_operator

    if not validate_operator(by):
        raise ConfigError("--by is empty", remedy="give the name of the person who has looked at the bench")
    stopped = find_unconfirmed_stop(station, database_url(database))
    if stopped is None:
        announce(
            f"nothing to confirm: no emergency stop ended the latest run at station {station}, or it is confirmed"
        )
        return
    confirm_bench(*stopped, station, by)
    announce(f"{by} has confirmed that the bench of station {station} is safe after run {stopped[0]}")


def _request(station: str, do: str, by: str) -> None:
    from cbsr_qa.station.control.client import RunChannel

    try:
        channel = RunChannel.connect(station)
    except RefusedError:
        if not _send_signals(station, do):
            raise
        return
    with channel:
        channel.ask(do, by=by or getpass.getuser())


def _send_signals(station: str, do: str) -> bool:
    """Stop a process that has no channel by signals: in order, or at once by a second one of another kind."""
    from cbsr_qa.station.control.lock import station_holder

    signals = {"stop": (signal.SIGTERM,), "emergency": (signal.SIGTERM, signal.SIGINT)}.get(do, ())
    holder = station_holder(station)
    return holder is not None and bool(signals) and all(map(holder.send, signals))


@dataclass(frozen=True, slots=True)
class PinLine:
    """A salted hash of a PIN, as the key ``pin`` of an operator in the station file."""

    pin: str


@command("station pin", prints="cbsr_qa.cli.station:PinLine")
def pin(as_json: AsJson = False) -> None:
    """Ask for a PIN and print its salted hash, a line for the operator in the station file.

    The PIN is typed twice at the terminal, or read from the first line of standard input.
    """
    from cbsr_qa.report.page import answer
    from cbsr_qa.system.pins import hash_pin, pin_allowed

    new_pin = read_pin("New PIN")
    if not pin_allowed(new_pin):
        remedy = "allowed: 4 to 64 printable characters, without a space at either end"
        raise ConfigError("the PIN cannot be used", remedy=remedy)
    if sys.stdin is not None and sys.stdin.isatty() and read_pin("The same PIN again") != new_pin:
        raise ConfigError("the two PINs differ", remedy="try again")
    line = PinLine(hash_pin(new_pin))
    show(
        answer(line, "add this to the operator's [[gate.operators]] table", "", (), (("pin", f'= "{line.pin}"'),)),
        as_json=as_json,
    )
