"""Recordings and arrays analysed without being told where or when the sensor was pressed."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from cbsr_qa.analysis.recording.table_files import TableForm
from cbsr_qa.app.analyse.analyse import analyse_file, analyse_frames
from cbsr_qa.app.analyse.outcome import Analysed, analyse_outcome
from cbsr_qa.app.analyse.request import AnalyseRequest
from cbsr_qa.config.loader import load_scanned_type
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.readings.frames import Recording, ScanKind
from cbsr_qa.interface.frames import Frames, frame_block, recording_dataset
from cbsr_qa.interface.result import Progress, Result, quiet
from cbsr_qa.interface.rows import RowOptions, Rows, rows_recording
from cbsr_qa.interface.scenes import Scene

if TYPE_CHECKING:
    import xarray as xr


class Analysis(Result[Analysed]):
    """Channels, noise and events of a recording; ``result.events`` holds places and times."""

    def frames(self) -> "xr.Dataset":
        """Return the frames as recorded, in the recording's unit; see :meth:`Run.frames`.

        RefusedError if no sensor type is known, or its frames have another shape.
        """
        analysed = self.result.result
        assert analysed is not None
        recording, sensor_type = analysed.recording, analysed.sensor_type
        shape = recording.frames.voltages.shape[1:]
        if sensor_type is None or sensor_type.pattern.shape != shape:
            raise RefusedError(
                f"{recording.path.name} has frames of {shape} of no known sensor type",
                remedy='name one that fits: analyse(…, sensor_type="disc-100mm")',
            )
        return recording_dataset(recording, sensor_type, recording.path.name)


def analyse(
    source: "str | Path | Scene | Frames",
    *,
    pattern: "Rows | None" = None,
    differences: bool = False,
    rest: "Rows | None" = None,
    complex_part: str | None = None,
    sensor_type: str | Path | None = None,
    time_s: ArrayLike | None = None,
    current_A: float | None = None,
    format: str | None = None,  # noqa: A002 - as the command's option
    dataset: str | None = None,
    reference: str | Path | tuple[str | Path, str] | None = None,
    memory_correction: bool | None = None,
    reconstruction: str | None = None,
    report: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> Analysis:
    """Find faulty channels, noise and presses in a recording, or in frames in memory.

    Parameters
    ----------
    source : file (text or path), a simulated scene, a dataset of frames, or an array (n, drives, measures) [V]. With
        a pattern: a table (path), or an array (n, columns) in any unit.
    pattern : electrode pairs of the columns, whose rows are frames: a table ``source,sink,plus,minus`` (path), or an
        array (columns, 4), electrodes from 0.
    differences : whether the readings are changes from the unloaded sheet.
    rest : rows of the unloaded sheet, like ``source``. Without them it is looked for in ``source``.
    complex_part : ``"real"``, ``"magnitude"`` or ``"in-phase"`` of complex readings, which are refused without it.
    sensor_type : file or shipped name; without it, lengths are in units of the radius.
    time_s, current_A : of an array; without times its frames count as one a second.
    format, dataset, reference, memory_correction : of a file; see ``cbsr-qa analyse``. ``reference`` may be a file
        with the name of a data set in it.
    reconstruction, options : method that images the events.
    report : whether to write one, of a file only.

    Raises
    ------
    CbsrError
        If the recording is refused, or a name is unknown.
    """
    if pattern is None and (differences or rest is not None or complex_part is not None):
        raise RefusedError(
            "differences, rest and complex_part are of rows of readings", remedy="give the pattern of the columns"
        )
    if isinstance(reference, str | Path):
        reference = (reference, "")
    request = AnalyseRequest(
        format=format,
        sensor_type=None if sensor_type is None else str(sensor_type),
        dataset=dataset,
        reference=None if reference is None else (Path(reference[0]), reference[1] or None),
        correct_carry_over=memory_correction,
        report=report,
        reconstruction=reconstruction,
        options=options,
    )
    tell = progress or quiet
    if pattern is not None:
        analysed = _analyse_rows(source, RowOptions(pattern, differences, rest, complex_part), request, time_s, tell)
    elif isinstance(source, str | Path):
        analysed = analyse_file(Path(source), request, tell=tell)
        if analysed.error is not None:
            raise analysed.error
    else:
        analysed = analyse_frames(_recording(source, time_s, current_A), request, tell=tell)
    return Analysis(analyse_outcome(analysed, imaged=reconstruction is not None or bool(options)))


def _analyse_rows(
    source: "Scene | Rows", options: RowOptions, request: AnalyseRequest, time_s: ArrayLike | None, tell: Progress
) -> Analysed:
    if isinstance(source, Scene):
        raise RefusedError("a scene states its pattern", remedy="leave pattern out")
    if request.sensor_type is None:
        raise RefusedError("a pattern without a sensor type", remedy='give one, e.g. sensor_type="disc-100mm"')
    if isinstance(source, str | Path) and isinstance(options.pattern, str | Path) and time_s is None:
        rest = None if options.rest is None else Path(str(options.rest))
        form = TableForm(Path(options.pattern), options.differences, rest, options.part)
        analysed = analyse_file(Path(source), replace(request, table=form), tell=tell)
        if analysed.error is not None:
            raise analysed.error
        return analysed
    recording, sensor_type = rows_recording(
        source, options, load_scanned_type(request.sensor_type).value, time_s=time_s
    )
    return analyse_frames(recording, request, sensor_type, tell=tell)


def _recording(source: "Scene | Frames", time_s: ArrayLike | None, current_A: float | None) -> Recording:
    if isinstance(source, Scene):
        return replace(source.recording, path=Path(f"scene {source.result.scene}"))
    frames = frame_block(source, time_s=time_s, current_A=current_A)
    about = getattr(source, "attrs", {})
    return Recording(
        path=Path(str(about.get("title", "array"))),
        format="array",
        dataset="",
        scan=ScanKind.FULL,
        frames=frames,
        clock="station" if about else "none" if time_s is None else "given",
        sensor_type=about.get("sensor_type"),
    )
