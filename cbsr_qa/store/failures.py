"""What a database says when something is wrong, turned into one clear message with what to do."""

import shlex
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import Any, TypeVar

from sqlalchemy import URL
from sqlalchemy.exc import DBAPIError, SQLAlchemyError, StatementError

from cbsr_qa.domain.errors import CbsrError, StoreError

#: Part of the driver's message → (what it means, what to do). The first that fits is used.
_KNOWN = (
    ("file is not a database", "is not a database", "name another file, or restore it from a copy"),
    ("malformed", "is damaged or cut off", "restore it from a copy; the damaged file is left as it is"),
    ("unable to open database file", "cannot be opened", "check that its folder exists and may be written to"),
    ("readonly database", "is read-only", "make the file and its folder writable, or name another database"),
    ("read-only transaction", "is read-only", "connect as a user who may write, or name another database"),
    ("permission denied", "refuses this user", "grant the user the right to read and write its tables"),
    ("database is locked", "is in use by another program", "end that program, or try again"),
    ("disk is full", "cannot grow: the disk is full", "free space; everything committed so far is kept"),
    ("no space left", "cannot grow: the disk is full", "free space; everything committed so far is kept"),
    (
        "disk i/o error",
        "cannot be read or written: the disk fails, or a quota or a limit on the size of files is reached",
        "check the disk and the limits (quota, ulimit -f); what is committed is kept as long as the disk keeps it",
    ),
    ("authentication failed", "refuses the user or the password", "check both in the database URL"),
    ("does not exist", "does not exist", "create it, or correct its name in the database URL"),
    ("connection refused", "does not answer", "start the server, or correct its address in the database URL"),
    ("could not translate host", "has an unknown host", "correct its address in the database URL"),
    ("failed to resolve host", "has an unknown host", "correct its address in the database URL"),
    ("server closed the connection", "hung up", "check the server; everything committed so far is kept"),
    ("terminating connection", "hung up", "check the server; everything committed so far is kept"),
)


_Word = TypeVar("_Word", bound=StrEnum)


def stored(words: type[_Word], value: Any, column: str, row: str) -> _Word:
    """Return a stored text as one of the words that a column may hold.

    Parameters
    ----------
    column : with its table, e.g. ``"analyses.outcome"``.
    row : its key in words, e.g. ``"analysis 0199…"``.

    Raises
    ------
    StoreError
        If it is not one of them.
    """
    try:
        return words(value)
    except ValueError:
        raise StoreError(
            f"the database is damaged: {row} states {column} {str(value)[:64]!r}, which is none of"
            f" {', '.join(words)}",
            remedy="restore the database from a copy; the row is left as it is",
        ) from None


def shown(url: URL) -> str:
    """Write a URL with its password hidden; a SQLite file as its path."""
    if url.get_backend_name() == "sqlite":
        return f"database {url.database or 'in memory'}"
    return f"database {url.render_as_string(hide_password=True)}"


def address(url: URL) -> str:
    """Write what ``--database`` takes, as a shell reads it: a file's path, or the URL with its password hidden."""
    sqlite = url.get_backend_name() == "sqlite"
    return shlex.quote(str(url.database) if sqlite else url.render_as_string(hide_password=True))


@contextmanager
def translated(url: URL) -> Iterator[None]:
    """Turn whatever the database raises inside into a StoreError that names it and says what to do."""
    try:
        yield
    except CbsrError:
        raise
    except UnicodeEncodeError as error:
        raise StoreError(
            f"{shown(url)} cannot hold {error.object[:60]!r}: {error.reason}", remedy="write it in UTF-8"
        ) from error
    except (UnicodeDecodeError, OverflowError) as error:  # Python's sqlite3 itself, of bytes that SQLite never checks
        raise _driver_error(url, sqlite3.DatabaseError(f"malformed: {error}")) from error
    except sqlite3.Error as error:  # outside of a statement, e.g. while a connection is set up
        raise _driver_error(url, error) from error
    except StatementError as error:
        if isinstance(error, DBAPIError) and error.orig is not None:
            raise _driver_error(url, error.orig) from error
        # A value our column types refuse.
        raise StoreError(f"{shown(url)}: {_first_line(str(error.orig))}") from error
    except SQLAlchemyError as error:
        raise StoreError(f"{shown(url)}: {_first_line(str(error))}") from error


def _driver_error(url: URL, error: BaseException) -> StoreError:
    said = _first_line(str(error))
    for part, meaning, remedy in _KNOWN:
        if part in said.lower():
            return StoreError(f"{shown(url)} {meaning} ({said})", remedy=remedy)
    return StoreError(f"{shown(url)}: {said}")


def _first_line(text: str) -> str:
    return text.strip().splitlines()[0] if text.strip() else "no reason given"
