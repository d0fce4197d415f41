"""The words of ``cbsr-qa reproduce paper``: tables that fit a page of a hundred columns."""

import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

from cbsr_qa.report.compared import agreement_sign, ours_text, printed_text

if TYPE_CHECKING:
    from cbsr_qa.app.reproduce import Reproduction
    from cbsr_qa.domain.published import ComparedTable, Comparison

WIDTH = 100
_NAME, _PAPER, _OURS, _BESIDE = 42, 18, 17, 17


def lines(found: "Reproduction") -> Iterator[str]:
    """Lay out every table, one line after another."""
    yield from textwrap.wrap(f"Ours is simulated: {found.words}. Seed {found.seed}.", WIDTH)
    for table in found.tables:
        yield ""
        yield from _table(table)


def _table(table: "ComparedTable") -> Iterator[str]:
    agreeing, of = table.counts
    yield f"{table.title}: {agreeing} of {of} agree"
    yield f"{'':<{_NAME}}{'paper':<{_PAPER}}{'simulated':<{_OURS}}{'bench, simulated':<{_BESIDE}}agrees"
    group, reasons = "", dict[str, list[str]]()
    for row in table.rows:
        if row.group != group:
            group = row.group
            yield f"  {group}"
        yield _row(row)
        if row.reason:
            reasons.setdefault(row.reason, []).append(f"{row.group} {row.name}")
    for note in table.notes:
        yield from textwrap.wrap(note, WIDTH, initial_indent="  note: ", subsequent_indent="    ")
    for reason, rows in reasons.items():
        shown = ", ".join(rows) if len(rows) < 4 else f"{len(rows)} rows"
        yield from textwrap.wrap(f"{shown}: {reason}", WIDTH, initial_indent="  why: ", subsequent_indent="    ")


def _row(row: "Comparison") -> str:
    beside = ours_text(row.beside[0]) if row.beside else ""
    name = f"    {row.name} [{row.unit}]" if row.unit != "1" else f"    {row.name}"
    name += " (input)" if row.kind == "input" else ""
    ours = ours_text(row.ours)
    return f"{name:<{_NAME}}{printed_text(row.printed):<{_PAPER}}{ours:<{_OURS}}{beside:<{_BESIDE}}" + (
        agreement_sign(row.agrees)
    )
