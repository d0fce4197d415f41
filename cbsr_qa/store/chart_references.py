"""References of control charts: appended; the latest of each chart holds, unless it retires the chart.

Rows that cannot be read are passed over; db check names them.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from sqlalchemy import Engine, insert

from cbsr_qa.domain.filling import fill_from_mapping
from cbsr_qa.domain.results.charts import ChartKind, ChartReference
from cbsr_qa.store.damage import read_word
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.mapping import row_of
from cbsr_qa.store.odd_rows import read_rows_apart
from cbsr_qa.store.outbox import Kind, announce
from cbsr_qa.store.tables.records import ChartReferenceRow

_SETTINGS: Final = ("subgroup", "rules", "weight", "width", "slack", "threshold")


class ChartReferences:
    """References of control charts."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def save(self, references: Sequence[ChartReference]) -> None:
        """Store references of charts in one transaction; earlier ones are kept.

        Raises
        ------
        StoreError
            If one is already stored, one of its runs is missing, or the database cannot be written.
        """
        if references:
            with writing(self._engine) as connection:
                connection.execute(insert(ChartReferenceRow), [_values(reference) for reference in references])
                announce(connection, Kind.CHART_REFERENCE, [reference.reference for reference in references])

    def read_current(self, station: str = "", until: str = "") -> tuple[ChartReference, ...]:
        """Return the current references of a station's charts in the order stored; retired charts have none.

        Parameters
        ----------
        station : empty for all stations.
        until : name of the last reference that counts, in sorting order; empty for no bound.
        """
        conditions = [ChartReferenceRow.station == station] if station else []
        if until:
            conditions.append(ChartReferenceRow.reference <= until)
        with reading(self._engine) as connection:
            rows = read_rows_apart(connection, ChartReferenceRow, *conditions).rows
        latest = {
            (reference.station, reference.recipe, reference.golden, reference.key, reference.chart): reference
            for reference in map(_reference, rows)
        }
        current = (reference for reference in latest.values() if not reference.retired)
        return tuple(sorted(current, key=lambda reference: reference.reference))

    def read_all(self, station: str = "") -> tuple[ChartReference, ...]:
        """Return all references of a station's charts (empty: of all stations), oldest first."""
        conditions = [ChartReferenceRow.station == station] if station else []
        with reading(self._engine) as connection:
            return tuple(map(_reference, read_rows_apart(connection, ChartReferenceRow, *conditions).rows))


def _values(reference: ChartReference) -> dict[str, Any]:
    settings = {name: getattr(reference, name) for name in _SETTINGS} | {"rules": list(reference.rules)}
    return {
        **row_of(ChartReferenceRow, reference, golden=reference.golden or "", kind=str(reference.chart)),
        # Only where set: most references are of charts in use.
        "settings": settings | ({"retired": True} if reference.retired else {}),
    }


def _reference(row: Mapping[str, Any]) -> ChartReference:
    settings = {name: row["settings"][name] for name in _SETTINGS}
    return fill_from_mapping(
        ChartReference,
        row,
        chart=read_word(ChartKind, row["kind"], "chart_references.kind", f"reference {row['reference']}"),
        golden=row["golden"] or None,
        retired=bool(row["settings"].get("retired", False)),
        **settings | {"rules": tuple(settings["rules"])},
    )
