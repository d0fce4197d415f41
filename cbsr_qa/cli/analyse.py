"""``cbsr-qa analyse``: recorded data through the same analysis."""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import AsJson, one_of, plugin_options
from cbsr_qa.cli.output import announce, emit_json, note, show


@command("analyse", prints="cbsr_qa.app.analyse.outcome:Analysed", reads="cbsr_qa.app.analyse.analyse")
def analyse(
    files: Annotated[list[Path], typer.Argument(help="Recordings.", metavar="FILE")],
    format_: Annotated[
        str | None, typer.Option("--format", metavar="NAME", help="File format; by default detected for each file.")
    ] = None,
    sensor_type: Annotated[
        str | None,
        typer.Option(help="Sensor type that was recorded; without it, lengths are in units of the radius."),
    ] = None,
    pattern: Annotated[
        Path | None,
        typer.Option(
            help="FILE is a table of frames (CSV, Parquet): a row per frame, a column per pair, and time_s if known."
            " This is the table source,sink,plus,minus (electrodes from 0) of its columns, as for calibrate."
        ),
    ] = None,
    differences: Annotated[
        bool, typer.Option("--differences", help="With --pattern: the readings are changes from the unloaded sheet.")
    ] = False,
    rest: Annotated[
        Path | None, typer.Option(help="With --pattern: frames of the unloaded sheet, with the columns of FILE.")
    ] = None,
    complex_part: Annotated[
        str | None,
        typer.Option(
            metavar="PART",
            help="With --pattern, of complex readings (1.2+0.3j): real, magnitude or in-phase; refused without it.",
        ),
    ] = None,
    dataset: Annotated[str | None, typer.Option(help="Data set to read, if a file holds several.")] = None,
    reference: Annotated[
        str | None,
        typer.Option(
            metavar="FILE[:NAME]",
            help="Recording of the unloaded sensor or empty tank: FILE, or FILE:NAME for one of its data sets.",
        ),
    ] = None,
    memory_correction: Annotated[
        bool | None,
        typer.Option(
            "--memory-correction/--no-memory-correction",
            help="Subtract what each reading carries over from the previous one; by default only if it clearly does.",
        ),
    ] = None,
    reconstruction: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Method that images the events (cbsr-qa plugins list --kind reconstruction lists them); by default"
            " gauss-newton-noser. It does not affect which events are found.",
        ),
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Option of the reconstruction, as in a recipe; repeatable."),
    ] = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write no report.")] = False,
    as_json: AsJson = False,
) -> int:
    """Find faulty channels, noise and presses in recordings, without being told where or when."""
    from cbsr_qa.analysis.recording.table_files import TableForm
    from cbsr_qa.app.analyse.analyse import analyse_file
    from cbsr_qa.app.analyse.outcome import AnalysedFiles, analyse_outcome
    from cbsr_qa.app.analyse.request import AnalyseRequest
    from cbsr_qa.calibration.presses.frame_tables import ComplexPart
    from cbsr_qa.report.document import json_document

    if pattern is None and (differences or rest is not None or complex_part is not None):
        missing = "it is missing: a table of frames needs the pairs of its columns"
        raise typer.BadParameter(missing, param_hint="--pattern")
    part = None if complex_part is None else one_of(ComplexPart, complex_part, "--complex-part")
    request = AnalyseRequest(
        format=format_,
        sensor_type=sensor_type,
        dataset=dataset,
        reference=None if reference is None else _reference(reference, files[0]),
        correct_carry_over=memory_correction,
        report=not no_report,
        reconstruction=reconstruction,
        options=plugin_options(option or ()),
        table=None if pattern is None else TableForm(pattern, differences, rest, part),
    )
    analysed_files = [analyse_file(path, request, tell=announce) for path in files]
    for file in analysed_files:
        if file.error is not None:
            names = [each.name for each in (file.file, pattern, rest) if each is not None]
            is_named = file.error.reason.startswith("--") or any(name in file.error.reason for name in names)
            note(f"cbsr-qa: {'' if is_named else f'{file.file.name}: '}{file.error}")
    if as_json:
        emit_json(
            json_document(analysed_files[0] if len(analysed_files) == 1 else AnalysedFiles(tuple(analysed_files)))
        )
    else:
        for file in analysed_files:
            if file.error is None:
                show(analyse_outcome(file, imaged=reconstruction is not None or bool(option)))
    return max(file.exit_code for file in analysed_files)


def _reference(text: str, first: Path) -> tuple[Path, str | None]:
    """Split FILE[:NAME]; a colon in the file's own name stays there, ``:NAME`` is in the same file."""
    if not text.strip(" :"):
        raise typer.BadParameter("it names no file; give FILE or FILE:NAME", param_hint="--reference")
    if Path(text).exists() or ":" not in text:
        return Path(text), None
    file, _, name = text.rpartition(":")
    return (Path(file) if file else first), name
