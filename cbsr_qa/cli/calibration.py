"""``cbsr-qa calibration``: look at an issued calibration file, and check it."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from cbsr_qa.cli.output import JsonOption, emit_json, say

app = typer.Typer(help="Look at calibration files and check them.", no_args_is_help=True)

_File = Annotated[Path, typer.Argument(help="The calibration file (HDF5).")]


@app.command("show")
def show(file: _File, json: bool = JsonOption) -> None:
    """Print what a calibration says: identity, range of use, baseline conductance, what was assumed."""
    from cbsr_qa.app.calibration_file import show_calibration

    document = show_calibration(file)
    if json:
        emit_json(document)
    else:
        say("\n".join(map(_printable, _summary(document))))


@app.command("verify")
def verify(file: _File, json: bool = JsonOption) -> None:
    """Check that a calibration file is whole, unchanged and of a version this program knows."""
    from cbsr_qa.app.calibration_file import verify_file

    document = verify_file(file)
    if json:
        emit_json(document)
    else:
        say(f"{document['file']} is sound: {document['datasets']} datasets, schema {document['schema_version']}")
        say(f"SHA-256 {document['digest']}")


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
    yield from ("", "Settling", *map(_settling, document["settling"]))
    yield from ("", f"Area overlap of at least {document['area_overlap']['threshold_percent']:g} % was asked for")
    image = document["image"]
    yield f"Images by {image['method']} on {image['elements']} elements from {image['readings']} readings, "
    chosen_by = image["regularisation_criterion"] or "not said"
    yield f"  {image['regularisation_name']} = {image['regularisation']:.4g}, chosen by {chosen_by}: "
    yield f"  {image['regularisation_how']}; noise floor {image['noise_floor']:.3g}; response: {image['response']}"
    yield f"SHA-256 {document['digest']}"


_IDENTITY = (
    ("sensor type", "sensor_type"),
    ("issued at", "issued_at"),
    ("run", "run"),
    ("calibration", "calibration"),
)


def _validity(validity: dict[str, Any]) -> Iterable[str]:
    yield f"  force: {_range(validity['force_N'], 'N')}"
    yield f"  strain: {_range([100 * end for end in validity['strain']], '%')}"
    yield f"  temperature: {_range(validity['temperature_C'], '°C')}"
    yield f"  within {validity['radius_mm']:g} mm of the centre, head: {validity['indenter']}"
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
        error = "" if parameter["stderr"] is None else f" ± {parameter['stderr']:.2g}"
        yield f"  {part} against {against}: {parameter['value']:.4g}{error}{units} ({parameter['source']})"


def _settling(summary: dict[str, Any]) -> str:
    what = f"  {summary['signal']}, {summary['direction']}: "
    counts = (
        f"{summary['accepted']} settled, {summary['censored']} not within the window, {summary['rejected']} rejected"
    )
    if summary["mean_s"] is None:
        return f"{what}no value ({counts})"
    at_least = "at least " if summary["censored"] else ""
    return f"{what}{at_least}{summary['mean_s']:.3g} s, deviation {summary['deviation_s']:.2g} s ({counts})"
