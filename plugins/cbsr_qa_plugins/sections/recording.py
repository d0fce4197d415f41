"""Sections of a recording: channels and noise, events, and rows of the file that were not used."""

from collections.abc import Iterator, Sequence

import numpy as np

from cbsr_qa.plugin import (
    Block,
    Disc,
    Figure,
    Goodness,
    ImagedPlace,
    LoadEvent,
    Paragraph,
    ReadingFlag,
    RecordingResult,
    ScanKind,
    Table,
    Trace,
)
from cbsr_qa.report.draw.channels import ChannelMark, channel_map_figure
from cbsr_qa.report.draw.images import ImagePanel, Marker, image_figure, sheet_radius
from cbsr_qa.report.draw.time import Span, timeline_figure
from cbsr_qa.report.section import RecordingSection
from cbsr_qa.report.tables import capital, format_fixed, format_or_dash, number, plural, text_table


class RecordingChannels(RecordingSection):
    """Section of saturated and stuck channels, reading memory, noise and its steps."""

    title = "Channels and noise"

    def blocks(self, result: RecordingResult) -> Iterator[Block]:
        """Return a table, a map, and steps of the noise, if any."""
        yield from (_facts(result), _map(result))
        if result.noise.steps:
            yield _steps(result)


def _facts(result: RecordingResult) -> Table:
    channels, noise = result.channels, result.noise
    unit = "counts" if noise.unit == "count" else noise.unit
    quiet_s = noise.quiet_s or (0.0, 0.0)
    memory = "taken out" if channels.memory_corrected else "not taken out"
    facts = (
        ("Readings imaged", str(channels.used)),
        ("Saturated", plural(len(channels.saturated), "channel") if channels.saturated else "none"),
        ("Stuck", plural(len(channels.stuck), "channel") if channels.stuck else "none"),
        ("Electrodes with a suspect contact", ", ".join(map(str, channels.suspect_electrodes))),
        ("Level over noise, median", _format_value(channels.snr_db, 1, " dB")),
        ("Reciprocity error, as recorded", _format_value(channels.reciprocity_error, 3)),
        ("Share of the previous reading in each", _format_value(channels.reading_memory, 1, f" %, {memory}", 100)),
        ("Reciprocity error without that share", _format_value(channels.reciprocity_error_corrected, 3)),
        (
            f"Noise of one reading ({format_fixed(quiet_s[0], 1)} to {format_fixed(quiet_s[1], 1)} s)",
            "" if noise.rms is None or noise.quiet_s is None else f"{number(noise.rms)} {unit} rms",
        ),
        ("Drift", "" if noise.drift_per_min is None else f"{number(noise.drift_per_min)} {unit}/min"),
        ("Readings beyond six times the noise", _format_value(noise.outliers or None, 2, " %", 100)),
    )
    rows = [(quantity, value) for quantity, value in facts if value]
    return text_table("Channels and noise.", ("Quantity", "Value"), rows, (1,))


def _format_value(value: float | None, decimals: int, unit: str = "", scale: float = 1) -> str:
    """Write a value that was found; nothing otherwise."""
    return "" if value is None else f"{format_fixed(scale * value, decimals)}{unit}"


def _map(result: RecordingResult) -> Figure:
    recording, channels = result.recording, result.channels
    level = np.median(recording.frames.voltages, axis=0)
    level[(recording.frames.flags & ReadingFlag.MISSING != 0).all(axis=0)] = np.nan
    one_row = recording.scan is ScanKind.DRIVEN_PAIRS

    def place_pairs(pairs: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
        return tuple((0, measure) for _, measure in pairs) if one_row else pairs

    saturated, stuck = len(channels.saturated), len(channels.stuck)
    return Figure(
        f"Level of each channel. Saturated: {saturated or 'none'}; stuck: {stuck or 'none'}.",
        f"Map of {level.shape[0]} by {level.shape[1]} channels; {saturated} saturated, {stuck} stuck.",
        channel_map_figure(
            level,
            label="median level",
            unit=recording.frames.unit.value,
            marks=(
                ChannelMark(place_pairs(channels.saturated), "x", "saturated"),
                ChannelMark(place_pairs(channels.stuck), "o", "stuck"),
            ),
        ),
    )


def _steps(result: RecordingResult) -> Table:
    rows = [
        [
            format_fixed(step.time_s, 3),
            "level" if step.what == "level" else "noise",
            number(step.before),
            number(step.after),
        ]
        for step in result.noise.steps
    ]
    caption = "Steps of level or noise that most channels share; the noise above is that of the longest stretch."
    return text_table(caption, ("Time [s]", "What", "Before", "After"), rows, (0, 2, 3))


_MAX_IMAGES = 12


class RecordingEvents(RecordingSection):
    """Section of the events of a recording, with the image of each."""

    title = "Events"

    def blocks(self, result: RecordingResult) -> Iterator[Block]:
        """Return the events as a table and as images, or the reason for none, and their traces."""
        if result.events:
            motions = [
                f"{_name(rank)} moves: {event.motion.words}"
                for rank, event in enumerate(result.events)
                if event.motion
            ]
            moving: list[Block] = (
                [Paragraph(f"{'. '.join(motions)}. The table gives where it is clearest.")] if motions else []
            )
            yield from (_table(result), *moving)
            yield from (_images(result), _imaging(result), _image_table(result.events))
        else:
            yield Paragraph(f"No event: {result.events_why}.", "note")
        if timeline := _timeline(result):
            yield timeline


def _name(rank: int) -> str:
    return f"E{rank + 1}"


def _direction(event: LoadEvent | ImagedPlace) -> str:
    return "centre" if event.central else format_fixed(event.electrode, 2)


def _table(result: RecordingResult) -> Table:
    events, still = result.events, result.frame_rate_hz is None
    in_rows = still and result.recording.rows
    no_time = "" if in_rows else "–"
    beside = any(event.fate for event in events)
    columns = {
        "Event": [_name(rank) for rank in range(len(events))],
        "Row": [_format_rows(event) if in_rows else "" for event in events],
        "Start [s]": [no_time if still else format_fixed(event.start_s, 1) for event in events],
        "Peak [s]": [no_time if still else format_fixed(event.peak_s, 1) for event in events],
        "End [s]": [no_time if still else format_fixed(event.end_s, 1) for event in events],
        "Electrode": [_direction(event) for event in events],
        "r/R": [format_fixed(event.r_over_R, 2) for event in events],
        "Conductance": ["rises" if event.sign > 0 else "falls" for event in events],
        "SNR": [format_fixed(event.snr, 1) for event in events],
        "Explained [%]": [format_or_dash(event.goodness, _format_explained) for event in events],
        "x [mm]": [_format_value(event.x_mm, 1) for event in events],
        "y [mm]": [_format_value(event.y_mm, 1) for event in events],
        "Force [N]": [_format_value(event.force_N, 2) for event in events],
        "Overlapping": [event.fate for event in events],
    }
    shown_columns = {title: [cell or "–" for cell in cells] for title, cells in columns.items() if any(cells)}
    texts = ("Event", "Conductance", "Overlapping")
    numeric = tuple(k for k, title in enumerate(shown_columns) if title not in texts)
    caption = (
        "Events found in the readings. Electrode: direction as a fractional electrode number. SNR:"
        " change over the noise of such changes in this recording. Explained: share of the change that loads on the"
        " modelled sheet explain, beside noise; ! where what they leave is more than noise and the model's errors."
        + (" Overlapping: whether the image shows an event during others as a separate region." if beside else "")
    )
    return text_table(caption, tuple(shown_columns), list(zip(*shown_columns.values(), strict=True)), numeric)


def _format_rows(event: LoadEvent) -> str:
    """Return the rows of a table without times, from 1, as events have them in place of seconds."""
    first, last = (round(time_s) + 1 for time_s in (event.start_s, event.end_s))
    return f"{first}" if first == last else f"{first}–{last}"


def _format_explained(fit: Goodness) -> str:
    return f"{100 * fit.explained:.0f}{'' if fit.in_model else ' !'}"


def _imaging(result: RecordingResult) -> Table:
    rows = []
    if (imaging := result.imaging) is not None:
        options = ", ".join(f"{name} = {value!r}" for name, value in imaging.reconstruction.options.items())
        rows += [["Reconstruction", imaging.reconstruction.name], ["Its options", options or "as by default"]]
        if (chosen := imaging.choice) is not None:
            value = f"{number(chosen.value)}, by {chosen.criterion or 'its author'}"
            rows += [[f"Parameter: {chosen.name}", value], ["Why", chosen.how]]
            rows.append(["Noise figure", number(chosen.noise_figure)])
    rows.append(["Used for", "these images; events, places and SNR are found in the readings, without images"])
    return text_table("How the images were made.", ("Choice", "Value"), rows)


def _image_table(events: Sequence[LoadEvent]) -> Table:
    rows = []
    for rank, event in enumerate(events):
        row_cells = ["–"] * 4
        if (seen := event.imaged) is not None:
            area, largest = format_fixed(100 * seen.area_share, 1), format_fixed(100 * seen.largest, 2)
            row_cells = [_direction(seen), format_fixed(seen.r_over_R, 2), largest, area]
        rows.append([_name(rank), *row_cells])
    columns = ("Event", "Electrode", "r/R", "Largest change [%]", "Area above half of it [% of the sheet]")
    caption = (
        "Where the images show the events: centre of mass of the region that belongs to the place of the best fit. A"
        " dash: the image shows no region there."
    )
    if any(event.imaged is not None and event.imaged.largest < -1 for event in events):
        caption += (
            " A change below −100 % is impossible: it is too large for the method, or the scale of the readings is"
            " not known. Places hold, amplitudes do not."
        )
    return text_table(caption, columns, rows, (1, 2, 3, 4))


def _images(result: RecordingResult) -> Figure:
    events, named = result.events, result.sensor_type
    from cbsr_qa.analysis.recording.imaging import nominal_disc  # a run's report has this section, and no recording

    shown_events = events[:_MAX_IMAGES]
    sensor = named or nominal_disc(result.recording.layout, result.recording.frames.voltages.shape[1])
    # Images of an unnamed sensor may be in any unit.
    sheet = Disc(sheet_radius(shown_events[0].image.mesh)) if named is None else named.outline
    panels = []
    for rank, event in enumerate(shown_events):
        place = Marker(event.x_over_R * sheet.radius_mm, event.y_over_R * sheet.radius_mm)
        moves = event.motion is not None
        track = np.array([point[1:] for point in event.track]) * sheet.radius_mm if moves else None
        note = f"{'clearest at ' if moves else ''}{event.place}"
        panels.append(ImagePanel(_name(rank), event.image, (place,), note, track))
    omitted = "" if len(shown_events) == len(events) else f" The first {len(shown_events)} of {len(events)}."
    moved = (
        " Line: the way of what moves, from the ring to the dot." if any(p.track is not None for p in panels) else ""
    )
    scale = " Each image has its own colour scale, below it." if len(panels) > 1 else ""
    return Figure(
        "Change each event made against the frames just before it (or against the reference). Marked: the place of"
        f" the best fit of a small load, which the blur of the image does not move.{moved}{scale}{omitted}",
        "; ".join(f"{panel.title}: {panel.note}" for panel in panels),
        image_figure(panels, sheet=sheet, electrodes=sensor.electrodes, shared_scale=False),
    )


def _timeline(result: RecordingResult) -> Figure | None:
    recording = result.recording
    block = recording.frames
    if result.frame_rate_hz is None or len(block) < 2 or result.channels.not_connected:
        return None
    first = np.median(block.voltages[: max(2, min(8, len(block) // 4))], axis=0)
    changed = np.sqrt(np.mean((block.voltages - first) ** 2, axis=(1, 2)))
    traces = [Trace("change", block.unit.value, block.time_s, changed)]
    traces += [Trace("force", s.unit, s.time_s, s.values) for s in recording.samples if s.channel == "force"]
    spans = [Span(e.start_s, e.end_s, _name(rank), e.peak_s) for rank, e in enumerate(result.events)]
    rows = "one row per frame" if recording.scan is ScanKind.DRIVEN_PAIRS else "all readings"
    count = plural(len(spans), "event") if spans else "no event"
    return Figure(
        f"Rms change of {rows} since the first frames, and force where it was recorded. Shaded: {count}.",
        f"Traces over {block.time_s[-1] - block.time_s[0]:.0f} s with {count}.",
        timeline_figure(traces, spans),
    )


_MAX_ROWS = 200


class RecordingRows(RecordingSection):
    """Section of rejected rows and notes, if there are any."""

    title = "Rows of the file"

    def blocks(self, result: RecordingResult) -> Iterator[Block]:
        """Return notes, and the rows that were rejected or noted."""
        recording = result.recording
        yield from (Paragraph(f"{capital(note)}.", "note") for note in recording.notes)
        shown_problems = sorted(recording.problems, key=lambda p: (not p.rejected, p.line))[:_MAX_ROWS]
        if shown_problems:
            omitted = len(recording.problems) - len(shown_problems)
            cost = f", {plural(recording.frames_dropped, 'frame')} dropped" if recording.frames_dropped else ""
            caption = f"{plural(recording.rows_rejected, 'row')} rejected{cost}; the rest is noted."
            caption += f" {omitted} more are not shown." if omitted else ""
            rows = [[str(p.line), "rejected" if p.rejected else "noted", p.what] for p in shown_problems]
            yield text_table(caption, ("Line", "Result", "Why"), rows, (0,))
