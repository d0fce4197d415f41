"""What the numbers can be traced to, and the state of the station when the run was made."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.plugin import (
    Block,
    ChangeHistory,
    ElectrodeKind,
    Electrodes,
    EndReason,
    Paragraph,
    PlacedElectrodes,
    RunObservation,
    RunRecord,
    RunResult,
    RunSession,
    SensorType,
    Table,
    VerdictOverride,
)
from cbsr_qa.report.section import RunSection
from cbsr_qa.report.station import chart_blocks, gate_blocks, station_blocks
from cbsr_qa.report.tables import duration, number, quantity, text_table
from cbsr_qa.system.clock import write_local_time

_OUTLINES: Final = {
    "contour": "bounded by a contour inside the elements",
    "elements": "whole elements, as the paper counts",
}


class Traceability(RunSection):
    """Section of instruments with identity and due dates, software versions, digest, geometry and settings."""

    title = "Traceability"
    leaf = 3

    def blocks(self, result: RunResult) -> Iterator[Block]:
        """Return the tables; those of overrides and sessions only if there are any."""
        record = result.record
        yield from (_instruments(record), _sensor(record))
        if result.calibration is not None and result.calibration.standards:
            yield _standards(result.calibration.standards)
        if result.observation is not None:
            yield _analysis(result.observation)
        if result.overrides:
            yield _overrides(result.overrides)
        yield from (_changes(result.history), _phases(record))
        if len(record.sessions) > 1:
            yield _sessions(record)
        yield from (Paragraph(words) for words in _attendance_lines(record))
        yield Paragraph(f"Software: {', '.join(' '.join(one) for one in record.identity.software)}.")


def _instruments(record: RunRecord) -> Table:
    """Return a row for each instrument; a column of which none has anything is left out."""
    rows = []
    for i in record.identity.instruments:
        due = i.calibration_due or ("–" if i.simulated else "not stated")
        notes = [*(["simulated"] if i.simulated else []), *(f"{what}: {value}" for what, value in i.notes)]
        rows.append([i.role, i.driver, i.model, i.serial or "–", i.firmware or "–", due, "; ".join(notes) or "–"])
    columns = ("Role", "Driver", "Model", "Serial", "Firmware", "Calibration due", "Notes")
    used = [place for place in range(len(columns)) if any(row[place] != "–" for row in rows)]
    return text_table(
        "Instruments on the bench, as they identified themselves.",
        [columns[place] for place in used],
        [[row[place] for place in used] for row in rows],
    )


def _standards(standards: Sequence[ReferenceStandard]) -> Table:
    rows = [
        [s.role_words, s.certificate, s.laboratory, s.date, s.due, f"{s.uncertainty:g} {s.unit}", f"{s.k:g}"]
        for s in standards
    ]
    columns = ("Role", "Certificate", "Laboratory", "Calibrated", "Due", "U", "k")
    return text_table("Reference standards, as the station states them.", columns, rows, (5, 6))


def _sensor(record: RunRecord) -> Table:
    sensor = record.sensor_type
    drives, measures = sensor.pattern.shape
    rows = [
        ["Sheet", f"{_size(sensor)}, {sensor.thickness_mm:g} mm thick"],
        ["Electrodes", _electrodes(sensor.electrodes)],
        ["Readings per frame", f"{drives} drive pairs × {measures} measure pairs"],
        ["Indenter", f"{record.indenter.words()}, {record.indenter.area_mm2:.1f} mm²"],
        ["Configuration digest (SHA-256)", record.identity.configuration_digest],
        ["Stored rows", record.chain.words],
    ]
    return text_table("Sensor and configuration.", ("Item", "Value"), rows)


def _size(sensor: SensorType) -> str:
    if sensor.polygon is None:
        return f"{2 * sensor.radius_mm:g} mm diameter"
    low_x, high_x, low_y, high_y = sensor.polygon.extent_mm
    rounded = f" rounded with {sensor.polygon.corner_radius_mm:g} mm" if sensor.polygon.corner_radius_mm else ""
    corners = f"{len(sensor.polygon.corners_mm)} corners{rounded}"
    return f"polygon of {corners}, {high_x - low_x:g} mm × {high_y - low_y:g} mm"


def _electrodes(electrodes: Electrodes) -> str:
    if isinstance(electrodes, PlacedElectrodes):
        kind = "pins" if electrodes.kind is ElectrodeKind.PIN else "strips along the edge"
        return f"{electrodes.count} {kind} of {electrodes.width_mm:g} mm, placed one by one"
    turn = "counterclockwise" if electrodes.counterclockwise else "clockwise"
    return (
        f"{electrodes.count} {electrodes.kind.value}s of {electrodes.width_mm:g} mm on a ring of"
        f" {electrodes.ring_radius_mm:g} mm radius, counted {turn} from {electrodes.first_angle_deg:g}°"
    )


def _analysis(run: RunObservation) -> Table:
    chosen, settings = run.reconstruction.choice, run.settings
    current = run.unloaded.current_A
    masks = ", ".join(f"{100 * fraction:g} %" for fraction in settings.masks)
    rows = [
        ["Reconstruction", run.reconstruction.method],
        ["Regularisation parameter", f"{chosen.name} = {number(chosen.value)}"],
        ["Parameter chosen by", f"{chosen.criterion or 'criterion not stated'}: {chosen.how}"],
        ["Noise weighting", _weighting(run)],
        ["Readings imaged", f"{int(run.usable.sum())} of {run.usable.size}"],
        ["Drive current", "not stated" if current is None else quantity(current, "A")],
        ["Reference", "mean of the unloaded frames" if settings.reference == "run" else "frames before each press"],
        ["Response to load", f"{run.response.value} ({run.response_how})"],
        ["Noise floor", f"{number(run.noise_floor)} (relative), from {len(run.noise_images)} unloaded images"],
        ["Masks", f"{masks}; {100 * run.main_mask:g} % decides"],
        ["Sensed region", _OUTLINES[settings.outline]],
        ["Overlap and outline", f"{settings.clipping} clipping, perimeter by {settings.perimeter}"],
    ]
    return text_table("Imaging and evaluation.", ("Choice", "Value"), rows)


def _weighting(run: RunObservation) -> str:
    if run.settings.noise_weighting == "equal":
        return "equal"
    return (
        f"measured: by the variance of each reading over {len(run.unloaded)} unloaded frames, shrunk towards a common"
        f" one; largest to smallest weight {number(run.weight_ratio)}"
    )


def _changes(history: ChangeHistory) -> Block:
    """List changes in the run's files since this sensor type last passed this recipe."""
    since = (
        f"since this type of sensor last passed this recipe (run {history.accepted_run})"
        if history.accepted_run
        else "(this sensor type had not passed this recipe before)"
    )
    if not history.changes:
        return Paragraph(f"Recipe, limits, station, sensor type and material: no change is recorded {since}.")
    rows = []
    for change in history.changes:
        content = f"{change.old_digest[:12]} → {change.new_digest[:12]}"
        by = (change.by or "not stated", change.why, change.run)
        rows.append([write_local_time(change.at), f"{change.kind} {change.name}", change.words(12), content, *by])
    columns = ("When", "File", "What changed", "Content (SHA-256)", "By", "Why", "First run with it")
    return text_table(f"Changes of recipe, limits, station, sensor type and material {since}.", columns, rows)


def _overrides(overrides: tuple[VerdictOverride, ...]) -> Table:
    rows = [[write_local_time(o.at), o.verdict.value, o.outcome.value, o.by, o.why] for o in overrides]
    caption = "Overrides of the verdict, oldest first. The latest one is valid; overrides do not issue calibrations."
    return text_table(caption, ("When", "Verdict", "Overridden to", "By", "Why"), rows)


def _phases(record: RunRecord) -> Table:
    rows = []
    for phase in record.phases:
        frames, presses = 0 if phase.frames is None else len(phase.frames), len(phase.loads) + len(phase.loops)
        spent = duration(phase.ended_s - phase.started_s)
        rows.append([phase.name, phase.sequence, spent, str(frames), str(presses)])
    columns = ("Phase", "Sequence", "Time", "Frames", "Presses")
    return text_table("Phases.", columns, rows, (2, 3, 4))


def _sessions(record: RunRecord) -> Table:
    """The run was interrupted: when, how, who went on, and what of it does not count."""
    first, *later = record.sessions
    rows = [["begun", _format_start(first), duration(0.0), "", _versions(first)]]
    for before, session in pairwise(record.sessions):
        end = f"was {before.end}: {before.detail}" if before.detail else f"was {before.end}"
        if before.end is EndReason.RUNNING:
            end = f"was cut off at {duration(session.started_s)}"
        by = f"resumed by {session.operator or 'somebody'}"
        rows.append([by, _format_start(session), duration(session.started_s), end, _versions(session)])
    aside = f"{record.set_aside} frames" if record.set_aside else "no frame"
    times = "once" if len(later) == 1 else f"{len(later)} times"
    caption = (
        f"The run was interrupted {times}. Presses that were cut off were made again; {aside} of them are stored and"
        " not analysed."
    )
    return text_table(caption, ("Session", "When", "At run time", "Because the one before", "Software"), rows, (2,))


def _attendance_lines(record: RunRecord) -> Iterator[str]:
    """Describe each pause and each answered prompt in one line."""
    names = {phase.index: phase.name for phase in record.phases}
    for pause in record.pauses:
        where = f"at {duration(pause.started_s)} of run time, in phase {names[pause.phase]!r}"
        if pause.duration_s is None:
            yield f"Paused by {pause.by} {where}; the session ended in this pause."
        else:
            yield (
                f"Paused by {pause.by} {where}, for {duration(pause.duration_s)}; continued by {pause.continued_by}."
                " The sheet rested longer before the next press, and frames for its reference were taken again."
            )
    for prompt in record.prompts:
        answer = "no answer" if prompt.answered_s is None else f"{prompt.by} answered {prompt.answer!r}"
        yield f"Asked at {duration(prompt.shown_s)} of run time, {prompt.text!r}: {answer}."


def _format_start(session: RunSession) -> str:
    return "not noted" if session.noted_at is None else write_local_time(session.noted_at)


def _versions(session: RunSession) -> str:
    return ", ".join(f"{name} {version}" for name, version in session.software[:1]) or "not noted"


class StationChecked(RunSection):
    """Section of the station's control charts that signal, the checks before the run, and its latest own check."""

    title = "Station"
    leaf = 3

    def blocks(self, result: RunResult) -> Iterator[Block]:
        identity = result.record.identity
        yield from chart_blocks(result.station_charts)
        yield from gate_blocks(result.record.gate)
        yield from station_blocks(identity.station, result.station_check, identity.started_at)
