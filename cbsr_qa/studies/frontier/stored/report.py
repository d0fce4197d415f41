"""Report of what fewer presses and shorter holds would have cost in stored runs."""

from typing import Final

from cbsr_qa.domain.results.report import Banner, CommandOutcome, Page, Paragraph, Section
from cbsr_qa.report.tables import text_table
from cbsr_qa.studies.frontier.report import list_notes, tabulate_points
from cbsr_qa.studies.frontier.stored.study import CHANGE, FORCE
from cbsr_qa.studies.frontier.study import Frontier

_CAPTION: Final = "Means of {sensors} sensors. •: no other way is as accurate in less time."
_READING: Final = (
    "Each row is the stored runs with some places left out or holds cut, analysed again from their own frames. The "
    "force error of a sensor is the root mean square over its random loads, which no way learned from, against the "
    "load cell; it holds the cell's own error. The first row is the runs as they were. ± is one standard error of a "
    "mean over sensors; the change is that of pairs, each sensor with itself.",
    "Time is that of the runs less the cycles and ends of holds that are left out; surfaces that need not be found "
    "would save more. Predicted: the end of a long hold is predicted from a short one, with relaxation from the "
    "longest holds of the run, the random loads among them.",
)


def lay_out_stored(frontier: Frontier) -> CommandOutcome[Frontier]:
    """Lay out the ways tried on stored runs."""
    points = frontier.points
    columns, rows = tabulate_points(points)
    table = text_table(_CAPTION.format(sensors=points[0].seeds), columns, rows, range(len(columns) - 1))
    notes = [Paragraph(f"{note}.", "note") for note in list_notes(points)]
    sections = (
        Section("How to read this page", tuple(map(Paragraph, _READING)), page_only=True),
        Section("Stored runs: fewer places and shorter holds", (table, *notes)),
    )
    return CommandOutcome(frontier, _page(frontier), sections)


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
        facts = [
            ("Recommended", words),
            ("Change of the error", f"{change.value:+.3f} ± {change.stderr or 0.0:.3f} N, in pairs"),
            *facts,
        ]
    return Page("Frontier", "What accuracy costs in stored runs", banner, tuple(facts), (), ())
