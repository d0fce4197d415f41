"""Tables of new SQLite databases: a test run makes thousands, and all migrations take 70 ms each time."""

from functools import wraps

import sqlalchemy as sa

from cbsr_qa.store import schema

_MADE = sa.text("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY type != 'table', rowid")


def tables_made_once(migrate):
    """Return ``schema._alembic`` that migrates the first new SQLite database of a process, and repeats what it made.

    ``tests/commands/test_migrations.py`` holds both against each other, and everything else against the real one.
    """
    made = []

    @wraps(migrate)
    def repeated(connection, direction, target):
        empty = connection.dialect.name == "sqlite" and not connection.scalars(_MADE).all()
        whole = empty and (direction, target) == ("upgrade", schema.HEAD)
        if whole and made:
            for statement in made:
                connection.exec_driver_sql(statement)
            return
        migrate(connection, direction, target)
        if whole:
            made.extend(connection.scalars(_MADE).all())
            made.append(f"INSERT INTO {schema.VERSION_TABLE} VALUES ('{schema.HEAD}')")

    return repeated
