"""``cbsr-qa calibration``: look at an issued calibration file, check it, convert it, turn frames into force."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from cbsr_qa.cli.output import JsonOption, emit_json, note, say

app = typer.Typer(help="Look at calibration files, check, convert and apply them.", no_args_is_help=True)

_File = Annotated[Path, typer.Argument(help="The calibration file (HDF5).")]


@app.command("show")
def show(file: _File, json: bool = JsonOption) -> None:
    """Print what a calibration says: identity, range of use, baseline conductance, what was assumed."""
    from cbsr_qa.app import show_calibration

    document = show_calibration(file)
    if json:
        emit_json(document)
    else:
        say("\n".join(map(_printable, _summary(document))))


@app.command("verify")
def verify(file: _File, json: bool = JsonOption) -> None:
    """Check that a calibration file is whole, unchanged and of a version this program knows."""
    from cbsr_qa.app import verify_file

    document = verify_file(file)
    if json:
        emit_json(document)
    else:
        say(f"{document['file']} is sound: {document['datasets']} datasets, schema {document['schema_version']}")
        say(f"SHA-256 {document['digest']}")
        if not document["bytes_checked"]:
            note("the file states no SHA-256 of its bytes, so they were not checked before HDF5 parsed them")


@app.command("export")
def export(
    file: Annotated[Path, typer.Argument(help="The calibration file, .h5 or .json.")],
    output: Annotated[Path, typer.Option(help="File to write, .json or .h5; must not exist yet.")],
    firmware: Annotated[
        bool, typer.Option("--firmware", help="Small JSON for a microcontroller; it says what it loses.")
    ] = False,
    stride: Annotated[
        int | None,
        typer.Option(min=1, help="Nodes of the lattice to one of the firmware's; by default as many as lose little."),
    ] = None,
    json: bool = JsonOption,
) -> None:
    """Convert a calibration: HDF5 to JSON and back without loss, or to small JSON for firmware."""
    from cbsr_qa.app import export_calibration

    if stride is not None and not firmware:
        raise typer.BadParameter("only --firmware has a lattice of its own", param_hint="--stride")
    converted = export_calibration(file, output, firmware=firmware, stride=stride)
    if json:
        emit_json(converted.document())
        return
    say(f"{converted.output}: {converted.size_bytes / 1e3:.0f} kB")
    if converted.loss is None:
        say(f"SHA-256 {converted.digest}, as before")
    else:
        loss = converted.loss
        say(
            f"every {loss['lattice_stride']}th node; at {loss['places']} calibrated places forces differ by"
            f" {loss['relative_force_error_rms']:.2%} rms and {loss['relative_force_error_worst']:.2%} at most;"
            f" {loss['places_lost']} places are lost"
        )


@app.command("apply")
def apply(
    file: _File,
    recordings: Annotated[list[Path], typer.Argument(help="Recordings, in any format known here.")],
    place: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="X Y", help="Where the head presses [mm from the centre]; by default it is found."),
    ] = None,
    format_: Annotated[
        str | None, typer.Option("--format", help="Format of the recordings; by default each is recognised.")
    ] = None,
    dataset: Annotated[str | None, typer.Option(help="One of several data sets in a file.")] = None,
    reference: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="The first N frames are of the unloaded sheet: changes are counted against them, and their scale is"
            " taken from the calibration's reference. Needed where a recording is in counts or states no current.",
        ),
    ] = None,
    serial: Annotated[
        str | None,
        typer.Option(help="Serial number of the sensor that was recorded, which must be the calibration's."),
    ] = None,
    output: Annotated[Path | None, typer.Option(help="CSV file to write; must not exist yet.")] = None,
    json: bool = JsonOption,
) -> int:
    """Turn the frames of recordings into force with its standard error, place and flags, a row a frame."""
    from cbsr_qa.app import ApplyRequest, applied_document, apply_calibration, as_csv, write_table

    request = ApplyRequest(place, format_, dataset, reference, serial)
    applied = apply_calibration(file, recordings, request, tell=lambda said: note(f"{said} …"))
    for one in applied:
        for remark in one.remarks:
            note(f"{one.path.name}: {remark}")
        if one.refused is not None:
            note(f"cbsr-qa: {one.refused}")
    if output is not None and any(one.refused is None for one in applied):
        write_table(output, as_csv(applied))
        note(f"written to {output}")
    if json:
        emit_json(applied_document(file, applied))
    elif output is None and any(one.refused is None for one in applied):
        say(as_csv(applied).rstrip())
    return max(0 if one.refused is None else one.refused.exit_code for one in applied)


def _printable(line: str) -> str:
    """A line without control characters: a file may come from anywhere, and a terminal obeys them."""
    return "".join(character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in line)


def _summary(document: dict[str, Any]) -> Iterable[str]:
    identity = document["identity"]
    yield f"Calibration of sensor {identity['serial']} (batch {identity['batch'] or 'not named'})"
    yield from (f"  {name}: {identity[key]}" for name, key in _IDENTITY)
    if document["simulated"]:
        yield f"  SIMULATED, not measured: {'; '.join(document['simulated'])}"
    yield from ("", "Where it may be used", *_validity(document["validity"]))
    yield from ("", "Baseline conductance (relative image units)", *_baseline(document["baseline_conductance"]))
    yield from ("", "Relative conductance change = slope · x + intercept")
    yield from _line("stress", document["against_stress"])
    yield from _line("strain", document["against_strain"])
    yield f"  assumed, not measured on this sensor: {', '.join(document['assumed']) or 'nothing'}"
    yield from ("", "Force", *_force(document))
    yield from ("", "Settling", *map(_settling, document["settling"]))
    yield from ("", f"Area overlap of at least {document['area_overlap']['threshold_percent']:g} % was asked for")
    image = document["image"]
    yield f"Images by {image['method']} on {image['elements']} elements from {image['readings']} readings, "
    chosen_by = image["regularisation_criterion"] or "not said"
    yield f"  {image['regularisation_name']} = {image['regularisation']:.4g}, chosen by {chosen_by}: "
    yield f"  {image['regularisation_how']}; noise floor {image['noise_floor']:.3g}; response: {image['response']}"
    yield from ("", "Values", *(_number(path, held) for path, held in document["values"].items()))
    yield f"SHA-256 {document['digest']}"


_IDENTITY = (
    ("sensor type", "sensor_type"),
    ("issued at", "issued_at"),
    ("run", "run"),
    ("calibration", "calibration"),
)


def _number(path: str, held: dict[str, Any]) -> str:
    units = "" if held["units"] == "1" else f" {held['units']}"
    return f"  {path:<28}" + ("not measured" if held["value"] is None else f"{held['value']:.6g}{units}")


def _validity(validity: dict[str, Any]) -> Iterable[str]:
    yield f"  force: {_range(validity['force_N'], 'N')}"
    yield f"  strain: {_range([100 * end for end in validity['strain']], '%')}"
    yield f"  temperature: {_range(validity['temperature_C'], '°C')}"
    yield f"  within {validity['radius_mm']:.3g} mm of the centre, head: {validity['indenter']}"
    yield from (f"  reduced: {reason}" for reason in validity["reduced"])


def _range(ends: list[float] | None, unit: str) -> str:
    return "not measured" if ends is None else f"{ends[0]:.3g} to {ends[1]:.3g} {unit}"


def _baseline(places: list[dict[str, Any]]) -> Iterable[str]:
    yield f"  {'place':<8}{'x [mm]':>8}{'y [mm]':>8}{'value':>12}{'± 1 s.e.':>12}{'loads':>7}"
    for place in places:
        value = "none" if place["value"] is None else f"{place['value']:.4g}"
        stderr = "" if place["stderr"] is None else f"{place['stderr']:.2g}"
        row = f"  {place['location']:<8}{place['x_mm']:>8.1f}{place['y_mm']:>8.1f}{value:>12}{stderr:>12}"
        yield f"{row}{place['loads']:>7}  {place['why']}".rstrip()


def _line(against: str, fit: dict[str, Any]) -> Iterable[str]:
    for part in ("slope", "intercept"):
        parameter = fit[part]
        units = "" if parameter["units"] == "1" else f" {parameter['units']}"
        error = f" ± {parameter['stderr']:.2g}" if parameter["stderr"] else ""  # 0 is: nobody doubted it
        yield f"  {part} against {against}: {parameter['value']:.4g}{error}{units} ({parameter['source']})"


def _force(document: dict[str, Any]) -> Iterable[str]:
    force = document["force_model"]
    if force is None:
        yield f"  none: {document['no_force_model']}"
        return
    low, high = (f"{100 * force[f'response_{end}']:.0f}" for end in ("lowest", "highest"))
    best, worst = (f"{100 * force[f'response_stderr_{end}']:.1f}" for end in ("lowest", "highest"))
    yield f"  the sheet answers with {low} to {high} % of what its material would at {force['places']} places,"
    yield f"  known to {best} to {worst} % (1 s.e.); single loads scatter by {100 * force['scatter']:.1f} %"
    x, y = force["least_force_worst_at_mm"]
    yield (
        f"  least force one frame detects: {force['least_force_centre_N']:.2g} N at the centre,"
        f" {force['least_force_worst_N']:.2g} N at worst, at ({x:.3g}, {y:.3g}) mm"
    )
    stress = force["stress_kPa"]
    yield f"  learned from {stress[0]:.3g} to {stress[1]:.3g} kPa, {force['hold_s']:.3g} s after the press"
    yield f"  assumed, not measured on this sensor: {', '.join(force['assumed']) or 'nothing'}"


def _settling(summary: dict[str, Any]) -> str:
    what = f"  {summary['signal']}, {summary['direction']}: "
    counts = (
        f"{summary['accepted']} settled, {summary['censored']} not within the window, {summary['rejected']} rejected"
    )
    if summary["mean_s"] is None:
        return f"{what}no value ({counts})"
    at_least = "at least " if summary["censored"] else ""
    deviation = "" if summary["deviation_s"] is None else f", deviation {summary['deviation_s']:.2g} s"
    return f"{what}{at_least}{summary['mean_s']:.3g} s{deviation} ({counts})"
