"""``cbsr-qa export``: what to write of which runs, in which format."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC
from pathlib import Path
from typing import BinaryIO, Final

from cbsr_qa.analysis.recording_files import write_recording
from cbsr_qa.app.export.eidors import write_eidors
from cbsr_qa.app.export.formats import ExportFormat, ExportTable, check_target, format_of
from cbsr_qa.app.export.frames import as_recording, join_channels, run_frames
from cbsr_qa.app.export.junit import suite, suites
from cbsr_qa.app.export.netcdf import frame_variables, netcdf_file
from cbsr_qa.app.export.tables import AT_ONCE, rows_of, table_writer
from cbsr_qa.app.run.decided_again import check_listed
from cbsr_qa.app.shift.lists import ListRequest, run_pages, trust_counts, trust_notes
from cbsr_qa.app.shift.report import exit_code
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import RefusedError, StoreError
from cbsr_qa.domain.numbers import did_you_mean
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.listed import ListedRun
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.run.changes import VerdictOverride
from cbsr_qa.domain.run.run import PhaseRecord, RunRecord
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import plural
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.files import write_atomically, writing
from cbsr_qa.system.words import echo

#: Largest number of times that progress is shown.
_STEPS: Final = 10
_ALTERED: Final = "restore the database from a copy; nothing was written (a table, CSV or Parquet, marks such runs)"


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """What to export.

    Parameters
    ----------
    to : file to write; its folder exists.
    run : a run, or a serial number for its latest run; None for the runs of ``runs``.
    runs : the selected runs; None if nothing selects them.
    format : format of the file; None for that of the suffix.
    table : what a row is; None for runs. For tables only.
    phase : name of the only phase whose frames are written; None for all. Of frames only.
    force : replace a file that exists.
    """

    to: Path
    run: str | None = None
    runs: ListRequest | None = None
    format: str | None = None
    table: str | None = None
    phase: str | None = None
    force: bool = False


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written.

    Parameters
    ----------
    runs : number of runs that the file is about.
    run : the only run, where the file is about one that was named; else null.
    table, rows : what a row is, and the number of rows; null unless the file is a table.
    altered : runs that do not match their chains: they are marked in a table, and no other file is written of them.
    frames, loads, overrides : frames and presses of the run, and overrides of its verdict; null and empty unless the
        file holds frames.
    """

    file: Path
    format: ExportFormat
    size_bytes: int
    runs: int
    run: str | None = None
    table: ExportTable | None = None
    rows: int | None = None
    altered: tuple[str, ...] = ()
    frames: int | None = None
    loads: int | None = None
    overrides: tuple[VerdictOverride, ...] = field(default=())


def export_data(
    request: ExportRequest, *, database: str | None, tell: Callable[[str], None]
) -> CommandOutcome[Exported]:
    """Write stored runs to one file, whole or not at all.

    Parameters
    ----------
    tell : called with progress.

    Raises
    ------
    RefusedError
        If the options do not go together, no run is selected, the file exists and is not to be replaced, cannot be
        written, or its format lacks a library or cannot hold the run.
    StoreError
        If there is no such run, or it is damaged; if one was altered, unless the file is a table.
    """
    kind = format_of(request.to, request.format)
    table = _table(request, kind)
    _check(request, kind)
    check_target(request.to, force=request.force)
    with open_store(database_url(database), create=False) as store:
        run = None if request.run is None else store.runs.resolve(request.run)
        if kind.of_frames:
            assert run is not None
            return _export_frames(store, run, request, kind, tell)
        return _export_runs(store, run, request, kind, table, tell)


def _table(request: ExportRequest, kind: ExportFormat) -> ExportTable:
    if request.table is None:
        return ExportTable.RUNS
    if not kind.of_table:
        raise RefusedError(f"--table with {kind}", remedy="it is for csv and parquet")
    if request.table not in list(ExportTable):
        hint = f"{did_you_mean(request.table, [*map(str, ExportTable)])} allowed: {', '.join(ExportTable)}"
        raise RefusedError(f"--table {echo(request.table, 64)} is not known", remedy=hint.lstrip())
    return ExportTable(request.table)


def _check(request: ExportRequest, kind: ExportFormat) -> None:
    """Refuse options that do not go together."""
    if request.run is not None and request.runs is not None:
        raise RefusedError("a RUN, and options that select runs", remedy="give one of them")
    if kind.of_frames and request.run is None:
        raise RefusedError(
            f"{kind} holds the frames of one run",
            remedy="name it: cbsr-qa export RUN --to FILE, or its serial number",
        )
    if request.phase is not None and not kind.of_frames:
        raise RefusedError(f"--phase with {kind}", remedy="it is for files of frames: recording, netcdf, eidors")


def _export_frames(
    store: Repository, run: str, request: ExportRequest, kind: ExportFormat, tell: Callable[[str], None]
) -> CommandOutcome[Exported]:
    target = request.to
    tell("reading the run")
    record, overrides = store.runs.load(run), store.changes.list_overrides(run)
    phases = record.phases if request.phase is None else (record.phase(request.phase),)
    if kind is ExportFormat.RECORDING:
        recording = as_recording(record, target, phases, overrides)
        write_recording(target, recording)
        frames = len(recording.frames)
    else:
        listed = _sound_run(store, run)
        frames = _write_frames(record, phases, listed, target, kind)
    loads = sum(len(phase.loads) + len(phase.loops) for phase in phases)
    size_bytes = target.stat().st_size
    exported = Exported(target, kind, size_bytes, 1, run, frames=frames, loads=loads, overrides=overrides)
    content = f"{plural(frames, 'frame')} and {plural(loads, 'press', 'presses')}"
    return _outcome(exported, content, (("Run", record.identity.words),))


def _sound_run(store: Repository, run: str) -> ListedRun:
    """Return a run as it is listed. Raise StoreError if it was altered."""
    (listed,) = store.lists.read_runs(RunSelection(up_to=run, latest=1))
    if listed.altered:
        raise StoreError(listed.altered, remedy=_ALTERED)
    return listed


def _write_frames(
    record: RunRecord, phases: tuple[PhaseRecord, ...], listed: ListedRun, to: Path, kind: ExportFormat
) -> int:
    """Write frames for other programs; returns their number."""
    frames = run_frames(record, phases)
    attributes = run_attributes(record, listed)
    with writing(to), write_atomically(to) as file:
        if kind is ExportFormat.EIDORS:
            write_eidors(file, record, frames, attributes)
        else:
            variables = frame_variables(record.sensor_type, frames, join_channels(phases))
            file.write(netcdf_file(variables, attributes))
    return len(frames.frames)


def run_attributes(record: RunRecord, listed: ListedRun) -> dict[str, str | float]:
    """Return what traces the frames of a run, for the file as a whole."""
    identity = record.identity
    return {
        "title": f"Frames of {identity.words}",
        "source": "simulated: " + "; ".join(identity.simulated) if identity.simulated else "measured",
        "run": identity.run,
        "serial": identity.sensor.serial,
        "batch": identity.sensor.batch,
        "parts": "; ".join(map(str, identity.parts)),
        "sensor_type": identity.sensor.sensor_type,
        "material": record.material.name,
        "station": identity.station,
        "recipe": identity.recipe,
        "operator": identity.operator,
        "started_at": identity.started_at.astimezone(UTC).isoformat(),
        "end": str(record.end),
        "verdict": str(listed.verdict or "none"),
        "failure_codes": "; ".join(code.words for code in listed.failure_codes),
        "software": ", ".join(f"{name} {version}" for name, version in identity.software),
        "head": record.indenter.words(),
    }


def _export_runs(
    store: Repository,
    run: str | None,
    request: ExportRequest,
    kind: ExportFormat,
    table: ExportTable,
    tell: Callable[[str], None],
) -> CommandOutcome[Exported]:
    target = request.to
    list_request = request.runs or ListRequest(RunSelection(checks=False))
    run_request = None if run is None else ListRequest(RunSelection(up_to=run), latest=1)
    pages = run_pages(store, run_request or list_request, AT_ONCE)
    runs = rows = 0
    altered_names, trust_totals = list[str](), Counter[str]()
    with writing(target), write_atomically(target) as file:
        with _writer(store, file, kind, table) as write:
            for page in pages:
                written, altered_runs = write(page.runs)
                rows, runs = rows + written, runs + len(page.runs)
                altered_names += altered_runs
                trust_totals += trust_counts(page.runs)
                done_before = max(page.done - AT_ONCE, 0)
                if page.total > AT_ONCE and page.done * _STEPS // page.total > done_before * _STEPS // page.total:
                    tell(f"{page.done} of {page.total} runs")
        if not runs:
            raise RefusedError(
                "no run is selected: there is nothing to export",
                remedy="cbsr-qa runs with the same options lists what they select",
            )
    exported = Exported(
        target,
        kind,
        target.stat().st_size,
        runs,
        run,
        table if kind.of_table else None,
        rows if kind.of_table else None,
        tuple(altered_names),
    )
    content = plural(runs, "run")
    outcome = _outcome(exported, f"{plural(rows, 'row')}, {content}" if kind.of_table else content)
    trust_totals["altered"] = len(altered_names)
    page_of_file = replace(outcome.page, warnings=trust_notes(store, trust_totals))
    return replace(outcome, page=page_of_file, exit_code=exit_code(len(altered_names)))


@contextmanager
def _writer(
    store: Repository, file: BinaryIO, kind: ExportFormat, table: ExportTable
) -> Iterator[Callable[[Sequence[ListedRun]], tuple[int, tuple[str, ...]]]]:
    """Yield what writes some runs, and returns the number of its rows and the runs that are marked as altered."""
    if kind is ExportFormat.JUNIT:

        def add_suites(runs: Sequence[ListedRun]) -> tuple[int, tuple[str, ...]]:
            for run in runs:
                if run.altered:
                    raise StoreError(run.altered, remedy=_ALTERED)
            judged = store.lists.read_limited_measurements([run.run for run in runs])
            for run in runs:
                check_listed(run, judged.get(run.run, ()))
                file.write(suite(run, judged.get(run.run, ())))
            return len(runs), ()

        with suites(file):
            yield add_suites
        return
    with table_writer(file, kind, table) as writer:

        def add_rows(runs: Sequence[ListedRun]) -> tuple[int, tuple[str, ...]]:
            rows, altered = rows_of(store, table, runs)
            writer.write(rows)
            return len(rows), altered

        yield add_rows


def _outcome(exported: Exported, words: str, facts: tuple[tuple[str, str], ...] = ()) -> CommandOutcome[Exported]:
    label = "Recording" if exported.format is ExportFormat.RECORDING else "File"
    return answer(exported, "exported", words, facts, printed=((label, str(exported.file)),))
