"""Report of a reproduction: one section per table, with printed and simulated numbers side by side."""

from collections.abc import Iterator, Sequence
from typing import Final

from cbsr_qa.domain.results.report import Banner, Block, CommandOutcome, Figure, Page, Paragraph, Section
from cbsr_qa.report.tables import number, text_table, with_uncertainty
from cbsr_qa.studies.reproduce.compare import ComparedRow, ComparedTable, Ours, Printed, Rule, ValueOrigin
from cbsr_qa.studies.reproduce.reproduce import Reproduction

_NONE: Final = "–"
_AGREES: Final = {True: "yes", False: "no", None: _NONE}
_COLUMNS: Final = ("", "quantity", "paper", "simulated", "bench, simulated", "agrees", "why", "bands")

# Sentences, in reading order.
_COUNTS: Final = "{agreeing} of {compared} numbers that can be compared agree; every row that does not says why"
_AGREE: Final = "{agreeing} of {compared} numbers that are compared agree."
_NUMBERS: Final = "Numbers of the paper and of our simulation"
_BARS: Final = (
    "Mean and ± as printed (grey), of the simulated uniform sheet (blue) and, where it was simulated, of the bench "
    "sheet (orange, which may lie beyond the scale)."
)
_BARS_ALTERNATIVE: Final = "{title}: {rows} means with their deviations; the table below has the numbers."
_SETTLING: Final = (
    "Mean settling times over nine locations and all trials, with their standard errors, over the ranges the paper "
    "prints: pale its abstract's, darker those of 4.3.2, which contradict each other. Strains at which fewer than "
    "half of the fits pass R² of 0.85 have no mean."
)
_SETTLING_ALTERNATIVE: Final = "Simulated means by strain; the table below has the numbers."
_FORCE: Final = (
    "Errors of the force at L0, each press left out of what estimates it, with one response for the whole sheet: "
    "simulated uniform sheet and bench sheet over the standard deviation the paper prints (grey)."
)
_FORCE_ALTERNATIVE: Final = "Simulated force errors at the centre; the table below has their deviations."


def reproduction_outcome(reproduction: Reproduction) -> CommandOutcome[Reproduction]:
    """Lay a reproduction out."""
    sections = (Section(table.title, tuple(_table(table, reproduction))) for table in reproduction.tables)
    return CommandOutcome(reproduction, _page(reproduction), tuple(sections))


def _page(reproduction: Reproduction) -> Page:
    about, tables = reproduction.about, reproduction.tables
    agreeing, compared = sum(table.agreeing for table in tables), sum(table.compared for table in tables)
    identity = (
        ("Published", about.source),
        ("Ours", about.simulated_words),
        ("Seed", str(about.seed)),
        ("Station time", f"{about.station_s / 3600:.0f} h, simulated"),
    )
    banner = Banner("plain", "≈", "Paper and simulation", _COUNTS.format(agreeing=agreeing, compared=compared))
    return Page("Reproduction", "Published tables beside simulated sensors", banner, identity, about.simulated, ())


def _table(table: ComparedTable, reproduction: Reproduction) -> Iterator[Block]:
    yield Paragraph(_AGREE.format(agreeing=table.agreeing, compared=table.compared))
    yield from (Paragraph(note, "note") for note in table.notes)
    yield from _figures(table, reproduction)
    reasons = list(dict.fromkeys(row.reason for row in table.rows if row.reason))
    column_count = len(_COLUMNS) if any(row.paper.band for row in table.rows) else len(_COLUMNS) - 1
    rows = [_cells(row, reasons)[:column_count] for row in table.rows]
    yield text_table(_NUMBERS, _COLUMNS[:column_count], rows, (2, 3, 4))
    for place, reason in enumerate(reasons):
        yield Paragraph(f"{_letter(place)}: {reason}.".replace("..", "."))


def _figures(table: ComparedTable, reproduction: Reproduction) -> Iterator[Figure]:
    def draw() -> str:
        from cbsr_qa.studies.reproduce import draw  # loads matplotlib

        if table is reproduction.force:
            return draw.force_svg(reproduction.presses)
        return draw.settling_svg(table.rows) if table is reproduction.settling else draw.bars_svg(table.rows)

    if table in (reproduction.table3, reproduction.table4, reproduction.table5, reproduction.tableF6):
        yield Figure(_BARS, _BARS_ALTERNATIVE.format(title=table.title, rows=len(table.rows)), draw)
    elif table is reproduction.settling:
        yield Figure(_SETTLING, _SETTLING_ALTERNATIVE, draw)
    elif table is reproduction.force and any(forces.uniform_N for forces in reproduction.presses):
        yield Figure(_FORCE, _FORCE_ALTERNATIVE, draw)


def _letter(place: int) -> str:
    return "abcdefghijklmnopqrstuvwxyz"[place % 26] * (1 + place // 26)


def _cells(row: ComparedRow, reasons: Sequence[str]) -> tuple[str, ...]:
    name = row.name if row.unit == "1" else f"{row.name} [{row.unit}]"
    name += ", an input" if row.kind is ValueOrigin.INPUT else ""
    beside_text = _format_ours(row.beside[0]) if row.beside else _NONE
    agrees = "not compared" if row.rule is Rule.NONE else _AGREES[row.agrees]
    why = _letter(reasons.index(row.reason)) if row.reason else ""
    bands = f"{row.paper.band}, {row.ours.band}" if row.paper.band else ""
    return row.group, name, _format_printed(row.paper), _format_ours(row.ours), beside_text, agrees, why, bands


def _format_printed(printed: Printed) -> str:
    """Format a printed number as in the paper: ``18.1 ± 9.8``, ``0.6``, or both ranges."""
    if printed.ranges:
        return " / ".join(f"{r.low:g}–{r.high:g}" for r in printed.ranges)
    if printed.value is None:
        return "–"
    if printed.deviation is None:
        return f"{printed.value:g}"
    decimals = max(len(f"{value:g}".partition(".")[2]) for value in (printed.value, printed.deviation))
    return f"{printed.value:.{decimals or 1}f} ± {printed.deviation:.{decimals or 1}f}"


def _format_ours(ours: Ours) -> str:
    """Format our number with its uncertainty; ``–`` if missing, ``≥`` for a lower bound."""
    if ours.value is None:
        return "–"
    sign = "≥ " if ours.at_least else ""
    spread = ours.uncertainty
    if spread is None:
        return f"{sign}{number(ours.value)}"
    if spread < 5e-4 * abs(ours.value):  # more digits than the printed number are meaningless
        return f"{sign}{number(ours.value, 4)}"
    return f"{sign}{with_uncertainty(ours.value, spread)}"
