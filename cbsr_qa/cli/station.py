"""``cbsr-qa station``: looks after a station.

The words of ``cbsr-qa station check``: its lines by whom they are about, and what to do.
"""

import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Final

import typer

from cbsr_qa.cli.output import emit_json, note, operator_at_terminal, say

if TYPE_CHECKING:
    from cbsr_qa.app.station_check import CheckedStation
    from cbsr_qa.domain.run import CheckResult, StationCheck


app = typer.Typer(help="Look after a station.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Look after a station."""


@app.command()
def check(
    station: Annotated[str, typer.Argument(help="Station file, or the name of a shipped one.")],
    golden: Annotated[
        str | None, typer.Option(metavar="SERIAL", help="Golden sensor to run and to hold against its history.")
    ] = None,
    operator: Annotated[str, typer.Option(help="Who stands at the station.")] = "",
    ring_ohm: Annotated[
        float | None, typer.Option(help="Resistors of the reference ring; by default the station file's.")
    ] = None,
    ring: Annotated[bool, typer.Option(help="Measure the reference ring, where its resistors are known.")] = True,
    ring_connected: Annotated[
        bool, typer.Option("--ring-connected", help="The ring is in place of the sensor already; do not ask.")
    ] = False,
    sensor_type: Annotated[str | None, typer.Option(help="Instead of the station's own.")] = None,
    material: Annotated[str | None, typer.Option(help="Instead of the station's own.")] = None,
    seed: Annotated[int, typer.Option(help="Of anything simulated.", min=0, max=2**31 - 1)] = 0,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Talk to every instrument, measure a reference ring, run a golden sensor; store and show what came of it.

    Exit code 1 if something failed, 3 if no instrument answered.
    """
    from cbsr_qa.app.station_check import CheckRequest, check_station

    request = CheckRequest(
        station=station,
        golden=golden,
        operator=operator,
        ring_ohm=ring_ohm,
        ring=ring,
        ring_connected=ring_connected,
        sensor_type=sensor_type,
        material=material,
        seed=seed,
        database=database,
    )
    found = check_station(request, ask=operator_at_terminal(), tell=lambda stage: note(f"{stage} …"))
    if as_json:
        emit_json(found.document())
    else:
        _show(found)
    raise typer.Exit(found.exit_code)


def _show(found: "CheckedStation") -> None:

    for line in lines(found.check):
        say(line)
    say(f"check        {found.check.check}")
    say(f"page         {found.page or 'none: ' + found.page_why}")


_WIDTH: Final = 100
_NAME, _OUTCOME, _VALUE = 28, 10, 14
_INDENT: Final = " " * (_NAME + 4)


def lines(check: "StationCheck") -> Iterator[str]:
    """Lay out a check, one line after another; what is not well has its remedy below."""
    from cbsr_qa.domain.run import CheckOutcome

    failed, warned = (len(check.lines(outcome)) for outcome in (CheckOutcome.FAILED, CheckOutcome.WARNING))
    subject = ""
    for line in check.results:
        if line.subject != subject:
            subject = line.subject
            yield subject
        yield from _line(line)
    yield f"{str(check.outcome).upper()}: {failed} failed, {warned} warnings, {len(check.results)} lines"


def _line(line: "CheckResult") -> Iterator[str]:
    from cbsr_qa.report import quantity

    value = "" if line.value is None else quantity(line.value, line.unit)
    allowed = f"allowed: {line.allowed}" if line.allowed else ""
    first = f"  {line.name:<{_NAME}}  {line.outcome!s:<{_OUTCOME}}  {value:<{_VALUE}}"
    fits = len(first) + len(allowed) + 4 <= _WIDTH
    yield f"{first}  ({allowed})" if allowed and fits else first.rstrip()
    for words in ("" if fits else allowed, line.said, f"what to do: {line.remedy}" if line.remedy else ""):
        # Names of stations and addresses stay whole, so that they can be copied.
        yield from textwrap.wrap(
            words, _WIDTH, initial_indent=_INDENT, subsequent_indent=_INDENT, break_on_hyphens=False
        )
