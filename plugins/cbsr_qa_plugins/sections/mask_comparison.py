"""The percentage masks side by side: table of means, and metrics against time with the force behind."""

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.observation import MetricTimeline, RunObservation
from cbsr_qa.domain.report import Block, Figure, RunResult, Section, Table
from cbsr_qa.domain.steps import Role
from cbsr_qa.report.figures_metrics import Held, mask_timeline_figure
from cbsr_qa.report.select import SPATIAL, Measured, loads_of, mask_qualifier, observed, spread_text
from cbsr_qa.report.tables import text_table, unit_column


class MaskComparison:
    """Section that compares the masks on the grid of locations (paper: Table 3, Figs 10 and E.23)."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None where no grid was pressed or one mask was used."""
        run = observed(result)
        if run is None or not isinstance(result, RunResult) or len(run.settings.masks) < 2:
            return None
        if not loads_of(run, Role.GRID):
            return None
        blocks: list[Block] = [_table(result, run)]
        blocks += [_figure(timeline, run) for timeline in run.timelines]
        return Section("Masks compared", tuple(blocks))


def held_loads(run: RunObservation, phase: str) -> list[Held]:
    """Return when each load of a phase was held."""
    loads = [load.record for load in run.loads if load.phase == phase]
    return [Held(record.load.label, record.hold_start_s, record.release_start_s) for record in loads]


def _table(result: RunResult, run: RunObservation) -> Table:
    loads, measured = loads_of(run, Role.GRID), Measured(result.measurements)
    rows = []
    for fraction in run.settings.masks:
        qualifier = mask_qualifier(run, fraction)
        values = [measured.values(name, loads, qualifier) for name, _, _ in SPATIAL]
        spreads = [spread_text(found, unit) for found, (_, _, unit) in zip(values, SPATIAL, strict=True)]
        decides = "" if qualifier else " (decides)"
        rows.append([f"{100 * fraction:g} %{decides}", *spreads, f"{len(values[0])} of {len(loads)}"])
    columns = ["Mask", *(unit_column(name, unit) for _, name, unit in SPATIAL), "Loads seen"]
    caption = (
        "Mean ± standard deviation over all locations and trials of the steady images, for each percentage mask. A"
        " higher mask cuts the blob closer to its peak."
    )
    return text_table(caption, columns, rows, (1, 2, 3, 4))


def _figure(timeline: MetricTimeline, run: RunObservation) -> Figure:
    behind = " The force is drawn behind in light orange." if timeline.force is not None else ""
    return mask_timeline_figure(
        timeline,
        held_loads(run, timeline.phase),
        caption=f"Phase {timeline.phase}: spatial metrics of every frame taken while a load was held, for each"
        f" mask.{behind} A line that is missing for a hold means that no blob was seen.",
        alternative=f"Three panels against time, one line for each of {len(timeline.masks)} masks.",
    )
