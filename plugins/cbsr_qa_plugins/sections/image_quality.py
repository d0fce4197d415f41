"""GREIT's figures of merit by location, what was seen where nothing pressed, and how close two loads may be."""

from collections.abc import Sequence
from typing import Final

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation
from cbsr_qa.domain.report import Block, Paragraph, RunResult, Section, Table
from cbsr_qa.domain.steps import Role
from cbsr_qa.report.numbers import number, plural
from cbsr_qa.report.select import Measured, by_label, loads_of, observed, spread_text
from cbsr_qa.report.tables import bound_sign, text_table

#: Measurement, column.
_COLUMNS: Final = (
    ("amplitude_response", "AR"),
    ("position_error", "PE [mm]"),
    ("resolution", "RES"),
    ("shape_deformation", "SD"),
    ("ringing", "RNG"),
    ("false_regions", "False regions"),
)


class ImageQuality:
    """Section of the figures that do not depend on a mask, on the grid of locations or else on all loads."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None where none of its metrics was taken."""
        run = observed(result)
        if run is None or not isinstance(result, RunResult):
            return None
        blocks: list[Block] = [Paragraph(words) for words in _in_words(result.measurements) if words]
        loads = loads_of(run, Role.GRID) or run.loads
        measured = Measured(result.measurements)
        if any(measured.values(name, loads) for name, _ in _COLUMNS):
            blocks.append(_table(loads, measured))
        return Section("Image quality", tuple(blocks)) if blocks else None


def _in_words(measurements: Sequence[Measurement]) -> tuple[str, str]:
    apart = [m for m in measurements if m.name == "two_touch_resolution" and m.value is not None]
    ways = [f"{bound_sign([m])}{number(m.value or 0.0, 3)} mm on by {m.how.partition(';')[0]}" for m in apart]
    counts = {m.name: m.value for m in measurements if m.name in ("missed_loads", "merged_loads") and m.value}
    fates = " and ".join(f"{plural(int(count), 'load')} {name.partition('_')[0]}" for name, count in counts.items())
    return (
        f"Two equal loads are seen as two from {', from '.join(ways)} (linearised model, without noise)."
        if ways
        else "",
        f"At the main mask {fates}." if fates else "",
    )


def _table(loads: Sequence[LoadObservation], measured: Measured) -> Table:
    rows = [
        [label, *(spread_text(measured.values(name, members)) for name, _ in _COLUMNS)]
        for label, members in by_label(loads).items()
    ]
    caption = (
        "Figures of merit of Adler et al. 2009. AR: integral of the image, over head area times the change that the"
        " material file expects. PE: how much nearer to the centre it is seen. RES: size of the set above a quarter"
        " of the maximum, of the sheet. SD: its share outside a circle of its area. RNG: opposite sign outside that"
        " circle, of what is inside. False regions: at the main mask, beyond the loads held."
    )
    columns = ["Location", *(title for _, title in _COLUMNS)]
    return text_table(caption, columns, rows, tuple(range(1, len(columns))))
