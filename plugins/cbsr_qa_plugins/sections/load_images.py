"""Every load's image with the indenter over the blob."""

from typing import Final

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.report import Paragraph, RunResult, Section
from cbsr_qa.report.figures_loads import load_images_figure
from cbsr_qa.report.loads import seen_loads
from cbsr_qa.report.numbers import plural
from cbsr_qa.report.select import Measured, observed

#: More images than this are not printed; they are in the store.
_MOST: Final = 48


class LoadImages:
    """Section of small pictures, one a press."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None where nothing was pressed."""
        run = observed(result)
        if run is None or not run.loads or not isinstance(result, RunResult):
            return None
        # First trials come first where there are too many: they cover every place and strain.
        chosen = sorted(run.loads, key=lambda load: load.record.load.trial)[:_MOST]
        printed = [load for load in run.loads if any(load is kept for kept in chosen)]
        seen = seen_loads(printed, run, Measured(result.measurements))
        lost = sum(load.error_mm is None for load in seen)
        conducts = "more" if run.response.value == "increase" else "less"
        figure = load_images_figure(
            seen,
            run.record.sensor_type,
            caption="Steady image of each press, as reconstructed (no noise floor subtracted), all on one scale."
            f" Orange: the indenter. Black: outline of the sensed blob at the {100 * run.main_mask:g} % mask.",
            alternative=f"{plural(len(seen), 'image')}, {plural(lost, 'load')} not detected.",
        )
        words = f"Pressed places conduct {conducts} ({run.response_how})."
        left = len(run.loads) - len(printed)
        if left:
            words += f" {plural(left, 'press is', 'presses are')} not printed here; every frame is in the store."
        return Section("Images", (Paragraph(words), figure))
