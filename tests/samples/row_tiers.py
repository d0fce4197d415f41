"""Rows of a table of tests by tier: the most telling ones are in ``make test``, all others in ``make test-rest``."""

from collections.abc import Collection, Iterable

import pytest
from _pytest.mark import ParameterSet


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
        each if name in kept else pytest.param(*each.values, id=each.id, marks=[*each.marks, pytest.mark.rest])
        for name, each in zip(names, parameters, strict=True)
    ]


def _as_parameters(row: object) -> ParameterSet:
    if isinstance(row, ParameterSet):
        return row
    return pytest.param(*row) if isinstance(row, tuple) else pytest.param(row)
