"""The least rights on PostgreSQL that stations and readers need, as a script for the database's owner."""

from collections.abc import Sequence
from textwrap import fill
from typing import Final

from cbsr_qa.store.schema import VERSION_TABLE
from cbsr_qa.store.tables.records import ChartReferenceRow, ReleaseRow
from cbsr_qa.store.tables.results import AnalysisRow
from cbsr_qa.store.tables.runs import RunRow
from cbsr_qa.store.tables.sync import OutboxRow
from cbsr_qa.store.views import VIEWS

STATION: Final = "cbsr_station"
READER: Final = "cbsr_reader"

#: The only cells that a station may change, by table, with the reason. They say what is still to be sent, not what
#: happened: every other row is added, and never changed or removed.
CHANGED: Final = {
    "outbox": {
        "version": "a run that grows while it waits to be sent is announced again in its row",
        "noted_at": "with the time of that, once all that was announced before was sent",
    }
}
#: Tables to which the owner alone adds rows: upgrades, and what moves frames to archives.
OF_THE_OWNER: Final = ("sync_accepts", "archives")

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
    # All files of tables are registered.
    kinds = (AnalysisRow, ChartReferenceRow, OutboxRow, ReleaseRow)
    assert {kind.metadata for kind in kinds} == {RunRow.metadata}
    tables = sorted(RunRow.metadata.tables)
    readable = [*tables, VERSION_TABLE, *VIEWS]
    insertable = [name for name in tables if name not in OF_THE_OWNER]
    return "\n".join(
        (
            _HEAD.format(station=station, reader=reader),
            "-- Up to PostgreSQL 14, everyone may create functions that others' queries find.",
            "REVOKE CREATE ON SCHEMA public FROM PUBLIC;\n",
            _ROLE.format(role=station),
            _grant("SELECT", readable, station),
            _grant("INSERT", insertable, station),
            *(_grant(f"UPDATE ({', '.join(columns)})", [table], station) for table, columns in CHANGED.items()),
            "",
            _ROLE.format(role=reader),
            _grant("SELECT", readable, reader),
            "-- An upgrade makes views, and may make tables: readers may read those too.",
            f"ALTER DEFAULT PRIVILEGES IN SCHEMA public GRANT SELECT ON TABLES TO {reader};",
            "",
        )
    )


def _grant(right: str, names: Sequence[str], role: str) -> str:
    listed = fill(", ".join(names), 116, initial_indent="    ", subsequent_indent="    ")
    return f"GRANT {right} ON\n{listed}\nTO {role};"
