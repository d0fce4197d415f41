"""``cbsr-qa reproduce``: published results beside simulated sensors.

The words of ``cbsr-qa reproduce paper``: tables that fit a page of a hundred columns.
"""

import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.output import emit_json, note, say

if TYPE_CHECKING:
    from cbsr_qa.studies.reproduce import ComparedTable, Comparison, Reproduction


app = typer.Typer(help="Put published results beside simulated sensors.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Put published results beside simulated sensors."""


@app.command("paper")
def paper(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer trials and strains, and no bench sheet.")] = False,
    output: Annotated[Path | None, typer.Option(help="HTML page to write.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Tables 1 to 5 and F.6, settling times and force errors of Ellingham et al. beside our simulated sensors."""
    from cbsr_qa.studies.reproduce import reproduce_paper

    found = reproduce_paper(quick=quick, tell=note)
    if output is not None:
        found.write(output)
        note(f"page         {output}")
    if as_json:
        emit_json(found.document())
        return
    for line in lines(found):
        say(line)


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
    for remark in table.notes:
        yield from textwrap.wrap(remark, WIDTH, initial_indent="  note: ", subsequent_indent="    ")
    for reason, rows in reasons.items():
        shown = ", ".join(rows) if len(rows) < 4 else f"{len(rows)} rows"
        yield from textwrap.wrap(f"{shown}: {reason}", WIDTH, initial_indent="  why: ", subsequent_indent="    ")


def _row(row: "Comparison") -> str:
    from cbsr_qa.studies.reproduce import agreement_sign, ours_text, printed_text

    beside = ours_text(row.beside[0]) if row.beside else ""
    name = f"    {row.name} [{row.unit}]" if row.unit != "1" else f"    {row.name}"
    name += " (input)" if row.kind == "input" else ""
    ours = ours_text(row.ours)
    return f"{name:<{_NAME}}{printed_text(row.printed):<{_PAPER}}{ours:<{_OURS}}{beside:<{_BESIDE}}" + (
        agreement_sign(row.agrees)
    )
