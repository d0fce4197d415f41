"""Report of accuracy against the number of presses."""

from collections.abc import Sequence
from typing import Final

from cbsr_qa.domain.results.report import Banner, Block, CommandOutcome, Figure, Page, Paragraph, Section
from cbsr_qa.report.tables import duration, text_table, with_uncertainty
from cbsr_qa.studies.frontier.point import Accuracy, Point
from cbsr_qa.studies.frontier.presses.needed import COVERED, PLACE
from cbsr_qa.studies.frontier.presses.study import AT_RANDOM, IN_ORDER
from cbsr_qa.studies.frontier.report import list_notes
from cbsr_qa.studies.frontier.study import Frontier

_CAPTION: Final = (
    "•: better than guessing, and no fewer presses are as good within the errors. Learning and frame: time on one"
    " core."
)
_FIGURE: Final = (
    "Left: mean distance of the places found from the true ones, of presses that nothing was learned from; dashed:"
    " guessing, which always takes the middle of all presses. Right: share of them inside the regions of 68 %"
    " (filled) and 95 % (hollow), which should lie on the lines. Bars are standard errors."
)
_READING: Final = (
    "Presses are drawn at random, the place is learned from them as cbsr-qa calibrate does, and presses that were not"
    " drawn are located. What is drawn at random lies between the presses located; drift over a session then hardly"
    " matters. How much it matters the second table shows: there the first presses of the session locate its last.",
    "A draw is registered and learned from its own presses alone. Standard errors come from resampling the draws and"
    " the presses located, all from this one table: another sheet may differ by more. More presses than these are"
    " forecast by laws that fall towards a floor; the limits are those of all laws that fit, with 95 % confidence.",
)


def lay_out_presses(frontier: Frontier, name: str, target_mm: float | None = None) -> CommandOutcome[Frontier]:
    """Lay out accuracy against the number of presses of a recording called ``name``."""
    series = [
        (series_name, [point for point in frontier.points if point.series == series_name])
        for series_name in (AT_RANDOM, IN_ORDER)
        if any(point.series == series_name for point in frontier.points)
    ]

    def draw() -> str:
        from cbsr_qa.studies.frontier.presses.figures import draw_press_errors  # loads matplotlib

        return draw_press_errors(series, target_mm, frontier.guess_mm)

    figure = Figure(_FIGURE, "Errors and coverage against the number of presses; the tables have the numbers.", draw)
    sections = (
        Section("How to read this page", (figure, *map(Paragraph, _READING)), page_only=True),
        *(Section(f"Presses: {series_name}", tuple(_blocks(points))) for series_name, points in series),
    )
    return CommandOutcome(frontier, _page(frontier, name), sections)


def _page(frontier: Frontier, name: str) -> Page:
    recommended = frontier.recommended
    banner = Banner("plain", "–", "No number of presses recommended", recommended.why)
    if recommended.setting is not None and recommended.accuracy is not None:
        headline = f"{recommended.setting['presses']} presses: {_format_accuracy(recommended.accuracy[PLACE])} mm"
        banner = Banner("pass", "✓", headline, recommended.why)
    facts = [("Recording", name)]
    if frontier.guess_mm is not None:
        facts.append(
            ("Guessing", f"{frontier.guess_mm:.3g} mm, the error of always taking the middle of all presses")
        )
    if recommended.station_s is not None:
        facts.append(("Time of these presses", f"{duration(recommended.station_s)} at the pace of the table"))
    if frontier.quick:
        facts.append(("Sweep", "quick: few draws"))
    return Page("Frontier", "What accuracy costs in presses", banner, tuple(facts))


def _blocks(points: Sequence[Point]) -> list[Block]:
    columns = ("presses", "draws", "error of place [mm]", "68 % hold [%]", "95 % hold [%]", "taken for touches [%]")
    rows = [
        (
            str(point.knobs["presses"]),
            str(point.seeds),
            _format_accuracy(point.accuracy[PLACE]),
            *(_format_accuracy(point.accuracy[name], 100) for name in (*COVERED.values(), "in_model")),
            duration(point.costs["learning_s"]),
            f"{1e3 * (point.compute_s or 0.0):.1f} ms",
            "•" if point.pareto else "",
        )
        for point in points
    ]
    table = text_table(_CAPTION, (*columns, "learning", "frame", "worth it"), rows, range(len(columns) + 2))
    return [table, *(Paragraph(f"{note}.", "note") for note in list_notes(points))]


def _format_accuracy(accuracy: Accuracy, scale: float = 1) -> str:
    return with_uncertainty(scale * accuracy.value, scale * (accuracy.stderr or 0.0))
