"""References of control charts: added one after the other; the latest of each chart holds, unless it retires it."""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import Engine, Row, insert, select

from cbsr_qa.domain.run_figures import MetricKey
from cbsr_qa.domain.station_charts import ChartKind, ChartReference, ChartSettings
from cbsr_qa.store.chart_tables import ChartReferenceRow
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.failures import stored

_PLAIN = (
    *("reference", "station", "recipe", "golden", "unit", "mean", "deviation", "runs", "first_run", "last_run"),
    *("operator", "made_at", "why"),
)
_KEY = ("name", "phase", "qualifier", "location")
_SETTINGS = ("subgroup", "rules", "weight", "width", "slack", "threshold")


def save_references(engine: Engine, references: Sequence[ChartReference]) -> None:
    """Store references of charts beside the earlier ones, in one transaction.

    Raises
    ------
    StoreError
        If one is stored already, its runs are not, or the database cannot be written.
    """
    if references:
        with writing(engine) as connection:
            connection.execute(insert(ChartReferenceRow), [_values(one) for one in references])


def current_references(engine: Engine, station: str, until: str = "") -> tuple[ChartReference, ...]:
    """Return the references that hold of a station's charts, in the order they were stored; none of retired charts.

    Parameters
    ----------
    until : leave out those whose names sort after this one: what held when something of that name was made.
    """
    query = select(*ChartReferenceRow.__table__.columns).where(ChartReferenceRow.station == station)
    if until:
        query = query.where(ChartReferenceRow.reference <= until)
    with reading(engine) as connection:
        rows = connection.execute(query.order_by(ChartReferenceRow.reference)).all()
    latest = {(one.recipe, one.golden, one.key, one.settings.kind): one for one in map(_reference, rows)}
    holding = (one for one in latest.values() if not one.retired)
    return tuple(sorted(holding, key=lambda one: one.reference))


def all_references(engine: Engine, station: str = "") -> tuple[ChartReference, ...]:
    """Return every reference the charts of a station (empty: of all stations) ever had, oldest first."""
    query = select(*ChartReferenceRow.__table__.columns)
    if station:
        query = query.where(ChartReferenceRow.station == station)
    with reading(engine) as connection:
        return tuple(_reference(row) for row in connection.execute(query.order_by(ChartReferenceRow.reference)))


def _values(one: ChartReference) -> dict[str, Any]:
    settings = {name: getattr(one.settings, name) for name in _SETTINGS}
    return {
        **{name: getattr(one, name) for name in _PLAIN},
        **{name: getattr(one.key, name) for name in _KEY},
        "kind": str(one.settings.kind),
        # Only where it is, so that rows of earlier versions of this program read alike.
        "settings": settings | {"rules": list(one.settings.rules)} | ({"retired": True} if one.retired else {}),
    }


def _reference(row: Row[Any]) -> ChartReference:
    own = row._mapping
    settings = {name: own["settings"][name] for name in _SETTINGS}
    kind = stored(ChartKind, own["kind"], "chart_references.kind", f"reference {own['reference']}")
    return ChartReference(
        **{name: own[name] for name in _PLAIN},
        key=MetricKey(*(own[name] for name in _KEY)),
        settings=ChartSettings(kind, **settings | {"rules": tuple(settings["rules"])}),
        retired=bool(own["settings"].get("retired", False)),
    )
