"""Report of what fewer presses, shorter holds or the batch as prior would have cost in stored runs."""

from collections.abc import Iterator
from typing import Final

from cbsr_qa.domain.results.report import Banner, Block, CommandOutcome, Figure, Page, Paragraph, Section
from cbsr_qa.report.tables import text_table
from cbsr_qa.studies.frontier.report import list_notes, tabulate_points
from cbsr_qa.studies.frontier.stored.study import CHANGE, FORCE
from cbsr_qa.studies.frontier.study import Frontier

_CAPTION: Final = "Means of {sensors} sensors. •: no other way is as accurate in less time."
_READING: Final = (
    "Each row is the stored runs with some places left out or holds cut, analysed again from their own frames. The "
    "force error of a sensor is the root mean square over its random loads, which no way learned from, against the "
    "load cell; it holds the cell's own error. The first row is the runs as they were, without a batch. ± is one "
    "standard error of a mean over sensors; the change is that of pairs, each sensor with itself.",
    "Time is that of the runs less the cycles and ends of holds that are left out; surfaces that need not be found "
    "would save more. Predicted: the end of a long hold is predicted from a short one, with relaxation from the "
    "longest holds of the run, the random loads among them.",
    "Batch as prior: the model of the batch is learned for each sensor from the other sensors, as cbsr-qa batch "
    "model does. The sensor's own presses at the places that are kept test whether it is like them, and teach the "
    "rest.",
)
_PLOT: Final = "Force error against station time. Filled: worth its time. Ring: the way that is recommended."
_PLOT_ALTERNATIVE: Final = "Force errors against station time; the table has the numbers."
_PAIRS: Final = (
    "The batch as prior, on {sensors} sensors, each with a model of the others. The change is the mean of pairs, "
    "with its interval of 95 % over the sensors; the batch is recommended only where that shows a gain."
)
_UNTOLD: Final = (
    "Only places that were pressed can be kept: recipe adaptive-batch chooses its own by the batch, and has no long "
    "holds, so that it may need fewer presses or less time than is shown here."
)


def lay_out_stored(frontier: Frontier) -> CommandOutcome[Frontier]:
    """Lay out the ways tried on stored runs."""
    points = frontier.points
    columns, rows = tabulate_points(points)
    table = text_table(_CAPTION.format(sensors=points[0].seeds), columns, rows, range(len(columns) - 1))
    notes = [Paragraph(f"{note}.", "note") for note in list_notes(points)]

    def draw() -> str:
        from cbsr_qa.studies.frontier.figures import draw_station  # loads matplotlib

        return draw_station(points, frontier.recommended)

    figure = Figure(_PLOT, _PLOT_ALTERNATIVE, draw)
    sections = (
        Section("How to read this page", (*map(Paragraph, _READING), figure), page_only=True),
        Section("Stored runs: fewer places and shorter holds", (table, *notes)),
        Section("The batch as prior", tuple(_describe_batch(frontier))),
    )
    return CommandOutcome(frontier, _page(frontier), sections)


def _describe_batch(frontier: Frontier) -> Iterator[Block]:
    """What the batch changes about each way, and what is not known."""
    prior = frontier.batch
    assert prior is not None
    if prior.why:
        yield Paragraph(f"What the batch as prior would have cost is not known: {prior.why}.", "note")
        return
    columns = ("places", "hold [s]", "transients", "without [N]", "with the batch [N]", "change [N]")
    rows = [
        (
            str(change.places),
            f"{change.hold_s:g}",
            change.transients,
            f"{change.without_N:.3f}",
            f"{change.with_N:.3f}",
            f"{change.change_N:+.3f} ({change.low_N:+.3f} to {change.high_N:+.3f})",
        )
        for change in prior.changes
    ]
    yield text_table(_PAIRS.format(sensors=frontier.points[0].seeds), columns, rows, (0, 1, 3, 4, 5))
    yield Paragraph(_UNTOLD, "note")


def _page(frontier: Frontier) -> Page:
    recommended = frontier.recommended
    banner = Banner("plain", "–", "No way recommended", recommended.why)
    facts = [("Ways", str(len(frontier.points))), ("Sensors", str(frontier.points[0].seeds))]
    if recommended.setting is not None and recommended.accuracy is not None:
        force, change = recommended.accuracy[FORCE], recommended.accuracy[CHANGE]
        minutes, setting = (recommended.station_s or 0.0) / 60, recommended.setting
        headline = f"{force.value:.3f} ± {force.stderr or 0.0:.3f} N in {minutes:.0f} min"
        banner = Banner("pass", "✓", headline, recommended.why)
        words = f"{setting['places']} places held {setting['hold_s']:g} s, transients {setting['transients']}"
        words += ", the batch as prior" if setting["prior"] == "batch" else ""
        facts = [
            ("Recommended", words),
            ("Change of the error", f"{change.value:+.3f} ± {change.stderr or 0.0:.3f} N, in pairs"),
            *facts,
        ]
    return Page("Frontier", "What accuracy costs in stored runs", banner, tuple(facts), (), ())
