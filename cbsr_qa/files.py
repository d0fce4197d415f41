"""Files that appear whole or not at all, and tables that spreadsheets open safely."""

import csv
import io
import os
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

#: What spreadsheets take for the beginning of a formula.
_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r")


@contextmanager
def written_whole(path: Path) -> Iterator[BinaryIO]:
    """Write to a temporary file in the same folder; it replaces ``path`` when the block ends without an error.

    The mode is 0666 less the umask, which the kernel applies as it creates the
    file: asking for the umask means setting it, for all threads at once.

    Raises
    ------
    OSError
        If anything cannot be written; ``path`` is then as it was, and the temporary file is gone.
    """
    temporary = path.parent / f".{secrets.token_hex(8)}.partial"
    try:
        with temporary.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        with suppress(OSError):
            temporary.unlink()


def csv_text(rows: Iterable[Iterable[str | float | None]]) -> str:
    """Write rows as CSV: text in UTF-8, numbers to their last digit, nothing for None.

    An apostrophe goes before text that begins with ``= + - @``, a tab or a carriage return: spreadsheets would work
    it out as a formula (OWASP, CSV injection). Numbers stay as they are. Halves of characters, which names of files
    may hold, are escaped.
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(map(_cell, row) for row in rows)
    return text.getvalue()


def _cell(value: str | float | None) -> str | float | None:
    if not isinstance(value, str):
        return value
    shown = value.encode("utf-8", "backslashreplace").decode()
    return f"'{shown}" if shown.startswith(_FORMULA) else shown
