"""``cbsr-qa stream``: forces as they are taken, for programs that need them."""

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command, document
from cbsr_qa.cli.options import CertificateSignature, PublicKey, Withdrawn, plugin_options
from cbsr_qa.cli.output import live_output, note
from cbsr_qa.domain.errors import StoppedError

document(
    "stream messages",
    prints="cbsr_qa.app.stream.messages:StreamMessage",
)


@command("stream", live=True, reads="cbsr_qa.app.stream.stream")
def stream(
    calibration: Annotated[Path, typer.Argument(help="Calibration file (HDF5) of the sensor.")],
    driver: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="DRIVER",
            help="Driver of the instrument that takes frames (cbsr-qa plugins list --kind instrument lists them);"
            " replayed-recording plays a file.",
        ),
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option", "-o", metavar="KEY=VALUE", help="Option of the driver, as in a station file; repeatable."
        ),
    ] = None,
    station: Annotated[
        str | None,
        typer.Option(
            help="Station file, or the name of a shipped one, in place of --from: its frame source is used, and no"
            " head moves."
        ),
    ] = None,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PLACE",
            help="Where to: - for standard output (the default), tcp://HOST:PORT or unix:PATH to serve clients,"
            " mqtt://HOST:PORT/TOPIC or mqtts://USER@HOST to publish (port and topic may be left out); may be"
            " repeated.",
        ),
    ] = None,
    reference: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            help="The first N frames are of the unloaded sheet: changes are relative to them. Required if the driver"
            " gives counts or states no current.",
        ),
    ] = None,
    sensor_type: Annotated[
        str | None,
        typer.Option(help="Sensor type of a calibration from labelled presses, if it is not a shipped one."),
    ] = None,
    give_up: Annotated[
        float,
        typer.Option(metavar="SECONDS", min=0, help="How long to retry an instrument whose link is lost."),
    ] = 30.0,
    public_key: PublicKey = None,
    certificate: CertificateSignature = None,
    withdrawn: Withdrawn = None,
) -> int:
    """Send the force in every frame of an instrument to other programs, as lines of JSON or by MQTT.

    Ends on Ctrl-C, or when the instrument fails (exit code 3), with a message that says why.
    """
    from cbsr_qa.app.stream.messages import EndMessage
    from cbsr_qa.app.stream.outlets import Outlets
    from cbsr_qa.app.stream.source import FramesFrom
    from cbsr_qa.app.stream.stream import StreamRequest, stream_messages
    from cbsr_qa.plugin.discovery import discover
    from cbsr_qa.station.interrupts import Interrupts

    if option and driver is None:
        raise typer.BadParameter("it is for the driver of --from", param_hint="--option")
    plugins, places = discover(), to or ["-"]
    write = live_output() if "-" in places else None
    source = FramesFrom(driver, plugin_options(option or ()), station)
    request = StreamRequest(calibration, source, reference, sensor_type, give_up, public_key, certificate, withdrawn)
    with (
        Interrupts(lambda line: None) as interrupts,
        interrupts.listen(),
        Outlets(places, plugins, write=write, tell=note) as outlets,
    ):
        generator = stream_messages(request, plugins=plugins, tell=note, waiting=interrupts.idle)
        with closing(generator) as messages:
            for message in messages:
                outlets.send(message)
                if isinstance(message, EndMessage):
                    outlets.close()
                    note(f"{message.why}: {message.reason} ({message.frames} frames, {message.missed} missed)")
                    return message.exit_code
                if outlets.over:
                    raise StoppedError(f"the stream ends: {outlets.over}", remedy="start it again")
    return 0
