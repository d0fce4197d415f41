"""Which rows of a table ``make test`` runs: enough for the rule, its refusal and its edges; others are ``rest``."""

import pytest

REST = pytest.mark.rest


def rest_but(rows, *kept):
    """Return the rows of a table as parameters by name; those that are not named here belong to ``make test-rest``.

    Parameters
    ----------
    rows : name → value, or the values of one row.
    """
    assert {*kept} <= {*rows}, f"no such row: {', '.join(sorted({*kept} - {*rows}))}"
    return [
        pytest.param(*(row if isinstance(row, tuple) else (row,)), id=name, marks=() if name in kept else REST)
        for name, row in rows.items()
    ]


def rest_after(count, rows):
    """Return rows as parameters; those after the first so many belong to ``make test-rest``."""
    return [
        pytest.param(*(row if isinstance(row, tuple) else (row,)), marks=() if number < count else REST)
        for number, row in enumerate(rows)
    ]
