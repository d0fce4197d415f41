"""``cbsr-qa analyse``: recorded data through the same analysis."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.output import emit_json, note, say

if TYPE_CHECKING:
    from cbsr_qa.app.analyse import Analysed
    from cbsr_qa.domain.readings import LoadEvent, RecordingResult


def analyse(
    files: Annotated[list[Path], typer.Argument(help="Recordings.", metavar="FILE...")],
    format_: Annotated[
        str | None, typer.Option("--format", help="Format of the files; by default each file is recognised.")
    ] = None,
    sensor_type: Annotated[
        str | None, typer.Option(help="What was measured; without it lengths are in units of the radius.")
    ] = None,
    dataset: Annotated[str | None, typer.Option(help="One of several data sets in a file.")] = None,
    reference: Annotated[
        str | None, typer.Option(help="Recording of the unloaded or empty domain, FILE[:NAME].")
    ] = None,
    memory_correction: Annotated[
        bool | None,
        typer.Option(
            "--memory-correction/--no-memory-correction",
            help="Take the share of the previous reading out of each; by default where it is clearly there.",
        ),
    ] = None,
    reconstruction: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="What images the events, see `cbsr-qa plugins list --kind reconstruction`; by default"
            " gauss-newton-noser. Events are found without it.",
        ),
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Option of the reconstruction, as in a recipe; may be repeated."),
    ] = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write no report.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> int:
    """Find channels, noise and presses in recordings, without being told where or when."""
    from cbsr_qa.app.analyse import AnalyseRequest, analyse_file
    from cbsr_qa.cli.options import plugin_options

    request = AnalyseRequest(
        format=format_,
        sensor_type=sensor_type,
        dataset=dataset,
        reference=None if reference is None else _reference(reference, files[0]),
        correct_carry_over=memory_correction,
        report=not no_report,
        reconstruction=reconstruction,
        options=plugin_options(option or ()),
    )
    outcomes = [analyse_file(path, request, tell=lambda said: note(f"{said} …")) for path in files]
    if as_json:
        documents = [outcome.document for outcome in outcomes]
        emit_json(documents[0] if len(documents) == 1 else {"files": documents})
    for outcome in outcomes:
        if outcome.refused is not None:
            named = outcome.path.name in outcome.refused.reason
            note(f"cbsr-qa: {'' if named else f'{outcome.path.name}: '}{outcome.refused}")
        elif not as_json:
            _show(outcome, chosen=reconstruction is not None or bool(option))
    return max(outcome.exit_code for outcome in outcomes)


def _reference(text: str, first: Path) -> tuple[Path, str | None]:
    """Split FILE[:NAME]; a colon in the file's own name stays there, ``:NAME`` is in the same file."""
    if not text.strip(" :"):
        raise typer.BadParameter("it names no file; give FILE or FILE:NAME", param_hint="--reference")
    if Path(text).exists() or ":" not in text:
        return Path(text), None
    file, _, name = text.rpartition(":")
    return (Path(file) if file else first), name


def _show(outcome: "Analysed", *, chosen: bool) -> None:
    result = outcome.result
    if result is None:
        return
    recording, channels = result.recording, result.channels
    for remark in (*recording.notes, *outcome.warnings):
        note(f"note: {remark}")
    rate_hz = result.frame_rate_hz
    rate = "still" if rate_hz is None else f"{rate_hz:{'.2f' if rate_hz < 1e6 else '.3g'}} frames/s"
    name = f"{outcome.path.name}:{recording.dataset}" if recording.dataset else outcome.path.name
    frames, rows = _counted(len(recording.frames), "frame"), _counted(recording.rows_rejected, "row")
    say(f"{name}: {frames}, {rate}, {rows} rejected")
    if recording.simulated:
        say(f"  simulated {'; '.join(recording.simulated)}")
    say(f"  channels  {len(channels.saturated)} saturated, {len(channels.stuck)} stuck, {channels.used} imaged")
    if result.noise.rms is not None:
        steps = f", {_counted(len(result.noise.steps), 'step')}" if result.noise.steps else ""
        say(f"  noise     {result.noise.rms:.3g} {result.noise.unit} rms{steps}")
    if result.events and chosen:
        say(f"  images    {_chosen(result)}")
    for number, event in enumerate(result.events, start=1):
        imaged = f", {_imaged(event)}" if chosen else ""
        say(f"  {f'event E{number}':<9} {_said(event, still=result.frame_rate_hz is None)}{imaged}")
        if event.motion is not None:
            say(f"            moves: {event.motion.words}; the place above is where it is clearest")
    if not result.events:
        say(f"  no event  {result.events_why}")
    if outcome.report is not None:
        say(f"  report    {outcome.report}")


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _chosen(result: "RecordingResult") -> str:
    imaging = result.imaging
    if imaging is None or imaging.choice is None:
        return "none"
    choice = imaging.choice
    return f"{imaging.reconstruction.name}, {choice.name} {choice.value:.3g}: {choice.how}"


def _imaged(event: "LoadEvent") -> str:
    seen = event.imaged
    if seen is None:
        return "not in its image"
    return f"in its image: {seen.place}"


def _said(event: "LoadEvent", *, still: bool) -> str:
    when = "" if still else f"{event.start_s:.1f} to {event.end_s:.1f} s, "
    what = "conducts more" if event.sign > 0 else "conducts less"
    mm = "" if event.x_mm is None or event.y_mm is None else f" ({_mm(event.x_mm)}, {_mm(event.y_mm)} mm)"
    return f"{when}{event.place}{mm}, {what}, SNR {event.snr:.1f}"


def _mm(length: float) -> str:
    return f"{round(length, 1) + 0.0:.1f}"  # a rounded zero has no sign
