"""Databases of each kind: tests of this room open many in one process."""

from pathlib import Path

import pytest


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=(pytest.mark.postgres, pytest.mark.rest))])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Address of an empty database of each kind that is supported.

    What differs on PostgreSQL is in ``test_store_postgres.py``; that all the rest is the same there, ``make
    test-rest`` tells.
    """
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'runs.db'}"
    return str(request.getfixturevalue("postgres_database"))
