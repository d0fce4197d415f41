"""SQL statements and the command line's tree are compiled once for all tests of a process.

Every database that a test opens has an engine of its own, which compiles each statement again, and every command
that is run in the process builds the tree of all commands again: together that was half of the tests' time.
"""

from functools import cache

import sqlalchemy as sa
import typer.main
from sqlalchemy.util import LRUCache


class _Statements:
    """What SQLAlchemy asks for compiled statements, whichever engine of one kind of database compiled them."""

    def __init__(self):
        self._compiled = LRUCache(5000)

    def get(self, key):
        """Return a compiled statement, or None; the key's first part is the engine's own dialect."""
        return self._compiled.get(key[1:])

    def __setitem__(self, key, compiled):
        self._compiled[key[1:]] = compiled


@cache
def _statements(dialect):
    return _Statements()


@cache
def share_statements():
    """Have all engines of this process share their compiled statements, and all commands one tree."""

    @sa.event.listens_for(sa.Engine, "engine_connect")
    def share(connection):
        connection.execution_options(compiled_cache=_statements(type(connection.dialect)))

    typer.main.get_command = cache(typer.main.get_command)
