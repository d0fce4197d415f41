"""Channels and noise of a recording."""

import numpy as np

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.recording import ScanKind
from cbsr_qa.domain.report import Block, Figure, RunResult, Section, Table
from cbsr_qa.report.figures_channels import ChannelMark, channel_map_figure
from cbsr_qa.report.numbers import fixed, number, plural
from cbsr_qa.report.tables import text_table


class RecordingChannels:
    """Section of saturated and stuck channels, reading memory, noise and its steps."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None for runs."""
        if not isinstance(result, RecordingResult):
            return None
        blocks: list[Block] = [_facts(result), _map(result)]
        if result.noise.steps:
            blocks.append(_steps(result))
        return Section("Channels and noise", tuple(blocks))


def _facts(result: RecordingResult) -> Table:
    channels, noise = result.channels, result.noise
    unit = "counts" if noise.unit == "count" else noise.unit
    rows = [
        ["Readings imaged", str(channels.used)],
        ["Saturated", plural(len(channels.saturated), "channel") if channels.saturated else "none"],
        ["Stuck", plural(len(channels.stuck), "channel") if channels.stuck else "none"],
    ]
    if channels.suspect_electrodes:
        rows.append(["Electrodes with a suspect contact", ", ".join(map(str, channels.suspect_electrodes))])
    if channels.snr_db is not None:
        rows.append(["Level over noise, median", f"{fixed(channels.snr_db, 1)} dB"])
    if channels.reciprocity_error is not None:
        rows.append(["Reciprocity error, as recorded", fixed(channels.reciprocity_error, 3)])
    if channels.reading_memory is not None:
        done = "taken out" if channels.memory_corrected else "not taken out"
        rows.append(["Share of the previous reading in each", f"{fixed(100 * channels.reading_memory, 1)} %, {done}"])
    if channels.reciprocity_error_corrected is not None:
        rows.append(["Reciprocity error without that share", fixed(channels.reciprocity_error_corrected, 3)])
    if noise.rms is not None and noise.quiet_s is not None:
        stretch = f"{fixed(noise.quiet_s[0], 1)} to {fixed(noise.quiet_s[1], 1)} s"
        rows.append([f"Noise of one reading ({stretch})", f"{number(noise.rms)} {unit} rms"])
    if noise.drift_per_min is not None:
        rows.append(["Drift", f"{number(noise.drift_per_min)} {unit}/min"])
    if noise.outliers:
        rows.append(["Readings beyond six times the noise", f"{fixed(100 * noise.outliers, 2)} %"])
    return text_table("Channels and noise.", ("Quantity", "Value"), rows, (1,))


def _map(result: RecordingResult) -> Figure:
    recording, channels = result.recording, result.channels
    level = np.median(recording.frames.voltages, axis=0)
    one_row = recording.scan is ScanKind.DRIVEN_PAIRS

    def at(pairs: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
        return tuple((0, measure) for _, measure in pairs) if one_row else pairs

    saturated, stuck = len(channels.saturated), len(channels.stuck)
    return channel_map_figure(
        level,
        label="median level",
        unit=recording.frames.unit.value,
        marks=(
            ChannelMark(at(channels.saturated), "x", "saturated"),
            ChannelMark(at(channels.stuck), "o", "stuck"),
        ),
        caption=f"Level of each channel. Saturated: {saturated or 'none'}; stuck: {stuck or 'none'}.",
        alternative=f"Map of {level.shape[0]} by {level.shape[1]} channels; {saturated} saturated, {stuck} stuck.",
    )


def _steps(result: RecordingResult) -> Table:
    rows = [
        [fixed(step.time_s, 3), "level" if step.what == "level" else "noise", number(step.before), number(step.after)]
        for step in result.noise.steps
    ]
    caption = "Steps of level or noise that most channels share; the noise above is that of the longest stretch."
    return text_table(caption, ("Time [s]", "What", "Before", "After"), rows, (0, 2, 3))
