"""Rows of a table of tests by tier: ``make test`` runs the most telling ones, ``make test-rest`` all others.

The rule, its refusal and its edges stay in ``make test``.
"""

from collections.abc import Collection, Iterable, Mapping

import pytest
from _pytest.mark import ParameterSet

REST = pytest.mark.rest


def rest_but(kept: Collection[object], rows: Iterable[object]) -> list[ParameterSet]:
    """Mark rows with ``rest``, but those that are kept in ``make test``.

    Parameters
    ----------
    kept : the rows' ids where they have one, else the first of their values.
    rows : as of ``pytest.mark.parametrize``; a tuple is a row of several values.

    Raises
    ------
    ValueError
        What is kept is no row's.
    """
    parameters = [_as_parameters(row) for row in rows]
    names = [each.values[0] if each.id is None else each.id for each in parameters]
    if missing := [name for name in kept if not any(name is each or name == each for each in names)]:
        raise ValueError(f"{missing}: no such row; there are {names}")
    return [
        each if name in kept else pytest.param(*each.values, id=each.id, marks=[*each.marks, REST])
        for name, each in zip(names, parameters, strict=True)
    ]


def rest_but_named(rows: Mapping[str, object], *kept: str) -> list[ParameterSet]:
    """Return rows (name → value, or the values of one row) as parameters by name; as :func:`rest_but`."""
    return rest_but(kept, [pytest.param(*_as_parameters(row).values, id=name) for name, row in rows.items()])


def rest_after(count: int, rows: Iterable[object]) -> list[ParameterSet]:
    """Mark rows after the first so many with ``rest``."""
    parameters = [_as_parameters(row) for row in rows]
    return [
        each if number < count else pytest.param(*each.values, id=each.id, marks=[*each.marks, REST])
        for number, each in enumerate(parameters)
    ]


def _as_parameters(row: object) -> ParameterSet:
    if isinstance(row, ParameterSet):
        return row
    return pytest.param(*row) if isinstance(row, tuple) else pytest.param(row)
