"""Cells and rows that several sections write alike."""

from collections.abc import Iterable, Sequence

from cbsr_qa.domain.measurement import Bound, Limit, Measurement
from cbsr_qa.domain.report import Cell, Table
from cbsr_qa.report.numbers import plain, quantity, scaled_unit, unit_shown, with_uncertainty


def text_table(
    caption: str, columns: Sequence[str], rows: Sequence[Sequence[str | Cell]], numeric: Sequence[int] = ()
) -> Table:
    """Make a table from plain strings and cells."""
    cells = tuple(tuple(c if isinstance(c, Cell) else Cell(c) for c in row) for row in rows)
    return Table(caption, tuple(columns), cells, tuple(numeric))


def value_cell(measurement: Measurement | None, *, unit: bool = False) -> Cell:
    """Write a measurement's value, coloured by its outcome; a dash where nobody took it."""
    if measurement is None:
        return Cell("–")
    outcome = measurement.outcome if measurement.limit is not None else None
    if measurement.value is None:
        return Cell("not measured", outcome)
    return Cell(f"{bound_sign([measurement])}{_value_text(measurement, measurement.value, unit)}", outcome)


def bound_sign(measurements: Iterable[Measurement]) -> str:
    """Return ``"≥ "`` where any of some values is only a lower bound: their mean is one too."""
    return "≥ " if any(m.bound is Bound.LOWER and m.value is not None for m in measurements) else ""


def _value_text(measurement: Measurement, value: float, unit: bool) -> str:
    if unit:
        return quantity(value, measurement.unit, measurement.uncertainty)
    if measurement.uncertainty:
        return with_uncertainty(value, measurement.uncertainty)
    return plain(value, measurement.unit)


def limit_text(limit: Limit) -> str:
    """Write a limit: ``≤ 5 mm``, ``50 to 100 %``."""
    bounds = [b for b in (limit.lower, limit.upper) if b is not None]
    scale, shown = scaled_unit(max(bounds, key=abs), limit.unit)
    gap = "\N{NO-BREAK SPACE}" if shown else ""
    written = [f"{bound / scale:.4g}".replace("-", "\N{MINUS SIGN}") for bound in bounds]  # as whoever set it did
    sign = "" if len(bounds) > 1 else "≥ " if limit.lower is not None else "≤ "
    return f"{sign}{' to '.join(written)}{gap}{shown}"


def margin_text(measurement: Measurement) -> str:
    """Write the distance from the nearer bound, negative outside; empty where there is none.

    Of a lower bound that fails it is written too: it is at best that far outside.
    """
    if measurement.limit is None or measurement.value is None:
        return ""
    margin = measurement.limit.margin(measurement.value)
    if measurement.bound is Bound.LOWER and margin >= 0:
        return ""
    return f"{'+' if margin > 0 else ''}{quantity(margin, measurement.unit)}"


def unit_column(name: str, unit: str) -> str:
    """Head a column: ``E_CoM [mm]``."""
    shown = unit_shown(unit)
    return f"{name} [{shown}]" if shown else name
