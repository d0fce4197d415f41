"""What the areas of regions say about the sizes of loads: the other side of the overlap."""

from collections.abc import Sequence

import numpy as np

from cbsr_qa.analysis.size_response import FLAT, SizeResponse
from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.report import Block, Paragraph, RunResult, Section, Table
from cbsr_qa.report.figures_sizes import SizeSeries, size_figure
from cbsr_qa.report.numbers import number
from cbsr_qa.report.select import observed
from cbsr_qa.report.tables import text_table


class SizeResponses:
    """Section of the size response; only where the recipe measures it."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None where it was not measured."""
        run = observed(result)
        if run is None or not isinstance(result, RunResult):
            return None
        found = _measured(result.measurements)
        if not found:
            return None
        words = in_words(found)
        blocks: list[Block] = [Paragraph(words, "note" if any(one.flat for one in found) else "plain")]
        seen = [one for one in found if one.slope is not None]
        if seen:
            caption = (
                f"Diameter of a circle with the region's area (mask {100 * run.main_mask:g} %) against the diameter"
                " of what presses, without noise. On the dashed line regions are as large as their loads; a level"
                " line is a method that answers every load with the same region."
            )
            series, head_mm = [_series(one) for one in seen], run.record.indenter.diameter_mm
            blocks.append(size_figure(series, head_mm, caption=caption, alternative=words))
        return Section("Size response", (*blocks, _table(found)))


def _table(found: Sequence[SizeResponse]) -> Table:
    columns = ("Place", *(f"{diameter:.3g} mm" for diameter in found[0].diameters_mm), "Slope")
    rows = [[one.place, *(_number(area, 3) for area in one.areas_mm2), _number(one.slope, 2)] for one in found]
    caption = (
        "Area of the region [mm²] that round targets of these diameters leave. Slope: of its logarithm over the"
        f" target's area's; 1 is in proportion, below {FLAT:g} is called flat."
    )
    return text_table(caption, columns, rows, tuple(range(1, len(columns))))


def in_words(found: Sequence[SizeResponse]) -> str:
    """Say what an overlap is worth."""
    seen = [one for one in found if one.slope is not None]
    if not seen:
        return "Targets of no size leave a region in the images of this reconstruction."
    flattest = min(seen, key=lambda one: one.slope or 0.0)
    first, last = flattest.diameters_mm[0], flattest.diameters_mm[-1]
    areas = [area for area in flattest.areas_mm2 if area is not None]
    asked, got = (last / first) ** 2, areas[-1] / areas[0]
    said = (
        f"From {first:.3g} to {last:.3g} mm a load grows {number(asked, 2)} times in area; its region"
        f" ({flattest.place}) grows {number(got, 2)} times."
    )
    if any(one.flat for one in seen):
        return (
            f"{said} The response is flat: this reconstruction answers loads of every size with nearly the same"
            " region. An overlap near 100 % says that the region fits this head, not that its size was measured, and"
            " the area of a region says nothing about an unknown load. The load estimate measures sizes."
        )
    return f"{said} Regions follow the size of what presses."


def _measured(measurements: Sequence[Measurement]) -> list[SizeResponse]:
    """Put what was measured together again, place by place."""
    areas: dict[str, list[tuple[float, float | None]]] = {}
    for m in measurements:
        place, _, target = m.qualifier.partition(", target of ")
        if m.name == "region_area" and target:
            areas.setdefault(place, []).append((float(target.removesuffix(" mm")), m.value))
    return [
        SizeResponse(place, tuple(diameter for diameter, _ in seen), tuple(area for _, area in seen))
        for place, seen in areas.items()
    ]


def _series(one: SizeResponse) -> SizeSeries:
    seen = [(d, a) for d, a in zip(one.diameters_mm, one.areas_mm2, strict=True) if a is not None]
    targets, areas = zip(*seen, strict=True)
    return SizeSeries(one.place, targets, tuple(float(2 * np.sqrt(area / np.pi)) for area in areas))


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else number(value, digits)
