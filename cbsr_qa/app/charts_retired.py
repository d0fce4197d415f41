"""Retiring charts of a station: a row more, which says that nothing is charted against their limits from here on."""

from collections.abc import Sequence
from dataclasses import replace

from cbsr_qa.app.charts_request import ChartsRequest
from cbsr_qa.app.figure_series import named
from cbsr_qa.clock import RealClock
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.station_charts import ChartReference
from cbsr_qa.store.repository import Repository


def held_references(store: Repository, request: ChartsRequest, recipe: str) -> list[ChartReference]:
    """Return the references that hold of the charts that are asked for."""
    return [
        one
        for one in store.chart_references(request.station)
        if (one.recipe, one.golden) == (recipe, request.golden)
        and (not request.metrics or one.key.name in request.metrics)
    ]


def retired(store: Repository, request: ChartsRequest, recipe: str) -> tuple[str, ...]:
    """Retire the charts of one kind, of the metrics that are named or of all; return a note that names them.

    Raises
    ------
    RefusedError
        If no such chart holds.
    """
    ending = request.retirement
    if ending is None:
        return ()
    held = held_references(store, request, recipe)
    own = [one for one in held if one.settings.kind is ending.kind]
    if not own:
        kinds = ", ".join(sorted({str(one.settings.kind) for one in held}))
        raise RefusedError(
            f"no chart {ending.kind} of these metrics holds on this station",
            remedy=f"charts that hold are {kinds}" if kinds else "there is none at all",
        )
    rows = [_ended(store, one, ending.operator, ending.why) for one in own]
    store.save_chart_references(rows)
    return (_note(rows),)


def _ended(store: Repository, one: ChartReference, operator: str, why: str) -> ChartReference:
    return replace(
        one, reference=store.new_id(), operator=operator, made_at=RealClock().wall(), why=why, retired=True
    )


def _note(rows: Sequence[ChartReference]) -> str:
    return f"retired by {rows[0].operator}: {named([one.label for one in rows])}; a new reference begins them anew"
