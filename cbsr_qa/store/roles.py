"""The least rights on PostgreSQL that stations and readers need, as a script for the database's owner."""

from collections.abc import Iterator
from typing import Final

from sqlalchemy import Table

from cbsr_qa.store.schema import VERSION_TABLE
from cbsr_qa.store.tables import AnalysisRow, ChartReferenceRow, ReleaseRow, RunRow
from cbsr_qa.store.views import VIEWS

STATION: Final = "cbsr_station"
READER: Final = "cbsr_reader"

#: The only cells that are filled in later, each once, by table; all other rows are added and never changed.
FILLED_LATER: Final = {"phases": ("ended_s",), "calibrations": ("superseded_by",)}

_HEAD: Final = """\
-- Roles of a cbsr-qa database: {station} stores runs and deletes nothing, {reader} reads.
-- Run this as the owner of the tables, connected to the database, after `cbsr-qa db upgrade`, and again after every
-- upgrade; it may be run any number of times:  cbsr-qa db roles | psql --single-transaction -v ON_ERROR_STOP=1 URL
-- Then give each station and each person a separate login:
--   CREATE ROLE bench_3 LOGIN PASSWORD '...' IN ROLE {station};
--   CREATE ROLE ada LOGIN PASSWORD '...' IN ROLE {reader};
"""
_ROLE: Final = """\
DO $$ BEGIN
    IF NOT EXISTS (SELECT FROM pg_roles WHERE rolname = '{role}') THEN
        CREATE ROLE {role} NOLOGIN;
    END IF;
END $$;
REVOKE ALL ON ALL TABLES IN SCHEMA public FROM {role};
REVOKE ALL ON SCHEMA public FROM {role};
GRANT USAGE ON SCHEMA public TO {role};
"""


def roles_script(station: str = STATION, reader: str = READER) -> str:
    """Return an SQL script for PostgreSQL that makes two roles and gives them rights on every table and view.

    Parameters
    ----------
    station, reader : names of the roles, in lower case.
    """
    return "\n".join((_HEAD.format(station=station, reader=reader), *_roles(station, reader)))


def _roles(station: str, reader: str) -> Iterator[str]:
    names = [table.name for table in _tables()]
    read = [*names, VERSION_TABLE, *VIEWS]
    yield _ROLE.format(role=station)
    yield _grant("SELECT", read, station)
    yield _grant("INSERT", names, station)
    for table, columns in FILLED_LATER.items():
        yield _grant(f"UPDATE ({', '.join(columns)})", [table], station)
    yield _ROLE.format(role=reader)
    yield _grant("SELECT", read, reader)
    yield "-- An upgrade makes views, and may make tables: readers may read those too."
    yield f"ALTER DEFAULT PRIVILEGES IN SCHEMA public GRANT SELECT ON TABLES TO {reader};\n"


def _tables() -> list[Table]:
    # All files of tables are registered.
    assert AnalysisRow.metadata is ChartReferenceRow.metadata is ReleaseRow.metadata is RunRow.metadata
    return RunRow.metadata.sorted_tables


def _grant(right: str, names: list[str], role: str) -> str:
    return f"GRANT {right} ON\n    {', '.join(names)}\nTO {role};"
