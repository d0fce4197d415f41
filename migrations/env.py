"""Alembic's environment. The program hands it an open connection; the ``alembic`` command line a URL."""

from alembic import context
from sqlalchemy import Connection, create_engine

from cbsr_qa.store.tables.results import AnalysisRow
from cbsr_qa.store.tables.runs import Base
from cbsr_qa.store.tables.sync import OutboxRow
from cbsr_qa.store.views import create_views, drop_views

# Importing the results' tables registers them beside the runs'.
assert AnalysisRow.metadata is OutboxRow.metadata is Base.metadata


def _migrate(connection: Connection) -> None:
    # SQLite changes a table by copying it ("batch"); both databases undo a migration that fails half-way.
    context.configure(
        connection=connection,
        target_metadata=Base.metadata,
        render_as_batch=connection.dialect.name == "sqlite",
        transactional_ddl=True,
    )
    with context.begin_transaction():
        drop_views(connection)  # a table below a view cannot be changed
        context.run_migrations()
        if context.get_context().get_current_revision() == context.get_head_revision():
            create_views(connection)


def _run() -> None:
    given = context.config.attributes.get("connection")
    if isinstance(given, Connection):
        _migrate(given)
        return
    url = context.config.get_main_option("sqlalchemy.url")
    if not url:
        raise SystemExit("give the database: alembic -c … with sqlalchemy.url, or use cbsr-qa db upgrade")
    with create_engine(url).begin() as connection:
        _migrate(connection)


_run()
