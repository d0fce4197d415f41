"""Rows of a recording that were not used, by line, and what else is worth knowing about the file."""

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.report import Block, Paragraph, RunResult, Section
from cbsr_qa.report.numbers import plural
from cbsr_qa.report.tables import text_table

_MOST_ROWS = 200


class RecordingRows:
    """Section of rejected rows and notes."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None for runs, and for files about which nothing needs to be said."""
        if not isinstance(result, RecordingResult):
            return None
        recording = result.recording
        blocks: list[Block] = [Paragraph(f"{note[:1].upper()}{note[1:]}.", "note") for note in recording.notes]
        shown = sorted(recording.problems, key=lambda p: (not p.rejected, p.line))[:_MOST_ROWS]
        if shown:
            left = len(recording.problems) - len(shown)
            cost = f", {plural(recording.frames_dropped, 'frame')} dropped" if recording.frames_dropped else ""
            caption = f"{plural(recording.rows_rejected, 'row')} rejected{cost}; the rest is noted."
            caption += f" {left} more are not shown." if left else ""
            rows = [[str(p.line), "rejected" if p.rejected else "noted", p.what] for p in shown]
            blocks.append(text_table(caption, ("Line", "What became of it", "Why"), rows, (0,)))
        return Section("Rows of the file", tuple(blocks)) if blocks else None
