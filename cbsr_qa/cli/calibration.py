"""``cbsr-qa calibration``: show, check, sign and convert calibration files, turn frames into force."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.command import command, group
from cbsr_qa.cli.options import AsJson, CertificateSignature, PublicKey, Withdrawn
from cbsr_qa.cli.output import announce, note, say, show as show_outcome

if TYPE_CHECKING:
    from cbsr_qa.app.calibration.apply import ApplyRequest
    from cbsr_qa.calibration.runtime.estimator import Estimator

group("calibration", "Show, check, sign, convert and apply calibration files.")

_STDOUT = Path("-")
_File = Annotated[Path, typer.Argument(help="Calibration file (HDF5).")]
_EitherFile = Annotated[Path, typer.Argument(help="Calibration file, .h5 or .json.")]


@command(
    "calibration show",
    prints="cbsr_qa.app.calibration.shown:ShownCalibration|cbsr_qa.app.calibration.presses_shown:ShownPressCalibration",
    reads="cbsr_qa.app.calibration.page",
)
def show(
    file: _File,
    every_field: Annotated[bool, typer.Option("--all", help="Print every field, not only what it does.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print what a calibrated sensor does, how well, and what was assumed; with --all every field of its file."""
    from cbsr_qa.app.calibration.page import show_calibration

    show_outcome(show_calibration(file, every_field=every_field), as_json=as_json)


@command(
    "calibration verify", prints="cbsr_qa.app.calibration.signing:SoundFile", reads="cbsr_qa.app.calibration.signing"
)
def verify(file: _EitherFile, public_key: PublicKey = None, as_json: AsJson = False) -> None:
    """Check that a calibration file is complete, unaltered and of a known version, and who signed it."""
    from cbsr_qa.app.calibration.signing import verify_file

    show_outcome(verify_file(file, public_key), as_json=as_json)


@command("calibration keygen", prints="cbsr_qa.app.calibration.signing:NewKey")
def new_key(
    file: Annotated[Path, typer.Argument(help="File for the private key; must not exist yet, nor FILE.pub.")],
    as_json: AsJson = False,
) -> None:
    """Make a key pair that signs calibrations: FILE, for its owner alone, and FILE.pub for everybody.

    If CBSR_QA_KEY_PASSPHRASE is set, to a passphrase or to @FILE, the private key is encrypted with it.
    """
    from cbsr_qa.app.calibration.signing import make_key

    show_outcome(make_key(file), as_json=as_json)


@command(
    "calibration sign", prints="cbsr_qa.app.calibration.signing:SignedFile", reads="cbsr_qa.app.calibration.signing"
)
def sign(
    file: _EitherFile,
    key: Annotated[Path, typer.Option(help="Private key, made by cbsr-qa calibration keygen.")],
    again: Annotated[bool, typer.Option("--again", help="Replace the signature that the file has.")] = False,
    as_json: AsJson = False,
) -> None:
    """Sign a calibration file in its place; its content stays as it is.

    CBSR_QA_KEY_PASSPHRASE is the passphrase of the key, or @FILE.
    """
    from cbsr_qa.app.calibration.signing import sign_file

    show_outcome(sign_file(file, key, again=again), as_json=as_json)


@command("calibration export", prints="cbsr_qa.app.calibration.file:Converted", reads="cbsr_qa.app.calibration.file")
def export(
    file: Annotated[Path, typer.Argument(help="Calibration file, .h5 or .json.")],
    output: Annotated[Path, typer.Option(help="File to write, .json or .h5; must not exist yet.")],
    firmware: Annotated[
        bool, typer.Option("--firmware", help="Small JSON for a microcontroller; it states what is lost.")
    ] = False,
    stride: Annotated[
        int | None,
        typer.Option(min=1, help="Keep every Nth node of the lattice; by default the largest N that loses little."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Convert a calibration: HDF5 to JSON and back without loss, or to small JSON for firmware."""
    from cbsr_qa.app.calibration.file import export_calibration

    if stride is not None and not firmware:
        raise typer.BadParameter("only --firmware has a separate lattice", param_hint="--stride")
    show_outcome(export_calibration(file, output, firmware=firmware, stride=stride), as_json=as_json)


@command(
    "calibration apply",
    prints="cbsr_qa.app.calibration.apply:AppliedCalibration|cbsr_qa.app.calibration.apply_places:AppliedPlaces",
    reads="cbsr_qa.app.calibration.apply",
)
def apply(
    file: _File,
    recordings: Annotated[list[Path], typer.Argument(help="Recordings, in any supported format.")],
    place: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="X Y", help="Where the head presses, in mm from the centre; by default estimated for each frame."
        ),
    ] = None,
    format_: Annotated[
        str | None, typer.Option("--format", help="Format of the recordings; by default detected for each.")
    ] = None,
    dataset: Annotated[str | None, typer.Option(help="Data set to read, if a file holds several.")] = None,
    reference: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="The first N frames are of the unloaded sheet: changes are relative to them, and their scale is"
            " taken from the calibration's reference. Required if a recording is in counts or states no current.",
        ),
    ] = None,
    serial: Annotated[
        str | None,
        typer.Option(help="Serial number of the recorded sensor; must match the calibration."),
    ] = None,
    pattern: Annotated[
        Path | None,
        typer.Option(
            help="For a calibration from labelled presses: table source,sink,plus,minus with one row per column of"
            " RECORDINGS, which is one table then. Order and polarity may differ from those that were calibrated."
            " Without it, RECORDINGS is one recording of the sensor type."
        ),
    ] = None,
    differences: Annotated[
        bool,
        typer.Option(
            "--differences", help="Calibration from presses: the readings are differences from the unloaded sheet."
        ),
    ] = False,
    rest: Annotated[
        Path | None,
        typer.Option(
            help="Calibration from presses: frames of the unloaded sheet, with the columns of the readings."
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="CSV file to write; must not exist yet. - writes to the terminal.")
    ] = None,
    public_key: PublicKey = None,
    certificate: CertificateSignature = None,
    withdrawn: Withdrawn = None,
    as_json: AsJson = False,
) -> int:
    """Turn the frames of recordings into force with its standard error, place and flags.

    A calibration from labelled presses turns a recording, or a table of readings (--pattern), into places.
    Shows a short table for each recording; --output writes one row per frame.
    """
    from cbsr_qa.app.calibration.apply import ApplyRequest, apply_calibration, apply_outcome, as_csv, write_table
    from cbsr_qa.calibration.loading import load_foreign_calibration
    from cbsr_qa.calibration.runtime.estimator import Ability

    estimator = load_foreign_calibration(file, public_key, certificate, withdrawn)
    request = ApplyRequest(place, format_, dataset, reference, serial, pattern, differences, rest)
    if pattern is None and Ability.READINGS in estimator.lacks and (differences or rest is not None):
        raise typer.BadParameter(
            "it is for calibrations from labelled presses", param_hint="--differences" if differences else "--rest"
        )
    if sum([differences, rest is not None, reference is not None]) > 1:
        raise typer.BadParameter("give one of --differences, --rest and --reference", param_hint="--differences")
    if pattern is not None or estimator.regions is not None:
        return _apply_to_rows(estimator, file, recordings, request, output, as_json=as_json)
    applied = apply_calibration(estimator, file, recordings, request, tell=announce)
    for recording in applied.recordings:
        if recording.error is not None:
            note(f"cbsr-qa: {recording.error}")
    if all(recording.error for recording in applied.recordings) and not as_json:
        return applied.exit_code
    if output == _STDOUT and not as_json:
        say(as_csv(applied).rstrip())
        return applied.exit_code
    if output is not None and any(recording.error is None for recording in applied.recordings):
        write_table(output, as_csv(applied))
    return show_outcome(apply_outcome(applied, output), as_json=as_json)


def _apply_to_rows(
    estimator: "Estimator",
    file: Path,
    readings: list[Path],
    request: "ApplyRequest",
    output: Path | None,
    *,
    as_json: bool,
) -> int:
    from cbsr_qa.app.calibration.apply import write_table
    from cbsr_qa.app.calibration.apply_places import apply_to_rows, places_csv, places_outcome

    if len(readings) != 1:
        raise typer.BadParameter("one table or recording is turned into places at a time", param_hint="RECORDINGS")
    if request.pattern is not None and request.reference is not None:
        raise typer.BadParameter("a table has --rest FILE", param_hint="--reference")
    applied = apply_to_rows(estimator, file, readings[0], request)
    if output == _STDOUT and not as_json:
        say(places_csv(applied).rstrip())
        return 0
    if output is not None and output != _STDOUT:
        write_table(output, places_csv(applied))
    return show_outcome(places_outcome(applied, output), as_json=as_json)
