"""What ``analyse --json`` prints.

A regularisation parameter in a JSON document.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cbsr_qa.domain import RowProblem
from cbsr_qa.domain.readings import (
    ChannelReport,
    EventImaging,
    LoadEvent,
    Motion,
    NoiseReport,
    Recording,
    RecordingResult,
)
from cbsr_qa.domain.results import ParameterChoice


def parameter_document(choice: ParameterChoice) -> dict[str, Any]:
    """Return what it is, what chose it and why, and the noise figure of the matrix (Adler et al. 2009 form)."""
    return {
        "name": choice.name,
        "value": choice.value,
        "criterion": choice.criterion or None,
        "reason": choice.how,
        "noise_figure": choice.noise_figure,
    }


def recording_document(recording: Recording, frame_rate_hz: float | None) -> dict[str, Any]:
    """Return what was read."""
    return {
        "format": recording.format,
        "dataset": recording.dataset or None,
        "frames": len(recording.frames),
        "scan": recording.scan.value,
        "frames_dropped": recording.frames_dropped,
        "rows_rejected": recording.rows_rejected,
        "problems": _problems(recording.problems),
        "frame_rate_hz": frame_rate_hz,
        "clock": recording.clock,
        "force_recorded": any(block.channel == "force" for block in recording.samples),
        "unit": recording.frames.unit.value,
        "current_A": recording.frames.current_A,
        "sensor_type": recording.sensor_type,
        "loads_documented": len(recording.loads),
        "notes": list(recording.notes),
        "simulated": list(recording.simulated),
    }


def unread_document(format_: str | None, problems: Sequence[RowProblem]) -> dict[str, Any]:
    """Return what is known of a file in which nothing can be analysed; what nobody knows is null.

    Parameters
    ----------
    format_ : name; None where no format knows the file.
    problems : found before the file was given up.
    """
    return {
        "format": format_,
        "dataset": None,
        "frames": 0,
        "scan": None,
        "frames_dropped": 0,
        "rows_rejected": sum(problem.rejected for problem in problems),
        "problems": _problems(problems),
        "frame_rate_hz": None,
        "clock": None,
        "force_recorded": None,
        "unit": None,
        "current_A": None,
        "sensor_type": None,
        "loads_documented": 0,
        "notes": [],
        "simulated": None,
    }


def _problems(problems: Sequence[RowProblem]) -> list[dict[str, Any]]:
    return [{"line": p.line, "what": p.what, "rejected": p.rejected} for p in problems]


def result_document(result: RecordingResult) -> dict[str, Any]:
    """Return a recording with everything that was found in it."""
    return {
        "recording": recording_document(result.recording, result.frame_rate_hz),
        "channels": _channels(result.channels),
        "reconstruction": None if result.imaging is None else _reconstruction(result.imaging),
        "events": [_event(event) for event in result.events],
        "events_why": result.events_why,
        "noise": _noise(result.noise, result.recording),
        "warnings": list(result.warnings),
        "compute_s": {stage: round(seconds, 4) for stage, seconds in result.compute_s},
    }


def _reconstruction(imaging: EventImaging) -> dict[str, Any]:
    """Say how images were made; no parameter where nothing was imaged."""
    choice = imaging.choice
    return {
        "name": imaging.reconstruction.name,
        "options": dict(imaging.reconstruction.options),
        "parameter": None if choice is None else parameter_document(choice),
        "elements": imaging.elements,
        "used_for": "images of the events and what is said of them; events are found in the readings, without images",
    }


def _channels(channels: ChannelReport) -> dict[str, Any]:
    return {
        "saturated": [list(pair) for pair in channels.saturated],
        "stuck": [list(pair) for pair in channels.stuck],
        "not_connected": channels.not_connected,
        "used": channels.used,
        "snr_db": channels.snr_db,
        "reciprocity_error": channels.reciprocity_error,
        "reading_memory": channels.reading_memory,
        "reciprocity_error_corrected": channels.reciprocity_error_corrected,
        "memory_corrected": channels.memory_corrected,
        "suspect_electrodes": list(channels.suspect_electrodes),
    }


def _event(event: LoadEvent) -> dict[str, Any]:
    document: dict[str, Any] = {
        "start_s": event.start_s,
        "peak_s": event.peak_s,
        "end_s": event.end_s,
        "x_over_R": event.x_over_R,
        "y_over_R": event.y_over_R,
        "r_over_R": event.r_over_R,
        "electrode": event.electrode,
        "sign": event.sign,
        "snr": event.snr,
        "fate": event.fate or None,
        "force_N": event.force_N,
    }
    if event.x_mm is not None:
        document |= {"x_mm": event.x_mm, "y_mm": event.y_mm}
    seen = event.imaged
    document["image"] = None
    if seen is not None:
        document["image"] = {
            "x_over_R": seen.x_over_R,
            "y_over_R": seen.y_over_R,
            "r_over_R": seen.r_over_R,
            "electrode": seen.electrode,
            "largest_change": seen.largest,
            "area_share": seen.area_share,
        }
    if event.track:
        document["track"] = [{"time_s": t, "x_over_R": x, "y_over_R": y} for t, x, y in event.track]
        document["motion"] = None if event.motion is None else _motion(event.motion)
    return document


def _motion(motion: Motion) -> dict[str, Any]:
    ends = {"from": motion.begins, "to": motion.ends}
    return {
        **{name: {"electrode": electrode, "r_over_R": r} for name, (electrode, r) in ends.items()},
        "turns": motion.turns,
        "nearest_r_over_R": motion.nearest_r_over_R,
        "words": motion.words,
    }


def _noise(noise: NoiseReport, recording: Recording) -> dict[str, Any]:
    times = recording.frames.time_s
    return {
        "rms": noise.rms,
        "unit": noise.unit,
        "drift_per_min": noise.drift_per_min,
        "steps": [
            {
                "time_s": step.time_s,
                "first_frame_after": int(np.searchsorted(times, step.time_s, side="right")),
                "what": step.what,
                "before": step.before,
                "after": step.after,
            }
            for step in noise.steps
        ],
        "quiet_s": None if noise.quiet_s is None else list(noise.quiet_s),
        "frames": noise.frames,
        "outliers": noise.outliers,
    }
