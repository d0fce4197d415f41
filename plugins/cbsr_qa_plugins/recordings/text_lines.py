"""Lines of a text file whatever is in it: one at a time, each of bounded length."""

import encodings.utf_8_sig  # noqa: F401 - where files are read, no other file can be opened beside them
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.recording import ReadOptions

#: Characters of a line that are looked at. Rows of readings have a few hundred; a binary file may have no line end.
LONGEST_LINE: Final = 1 << 14
#: After this many lines in a row without a reading the rest of a file is not looked at.
MOST_BAD_IN_A_ROW: Final = 5000


@dataclass(frozen=True, slots=True)
class TextLine:
    """One line.

    Parameters
    ----------
    number : 1-based.
    text : without its line end; NULs at its ends are gone (a file system pads files with them after a crash).
    ended : whether a line end follows; False only for the last line of a file.
    too_long : whether ``text`` is only its beginning.
    """

    number: int
    text: str
    ended: bool
    too_long: bool


def text_lines(path: Path) -> Iterator[TextLine]:
    """Read a file line by line; bytes that are no UTF-8 come out as replacement characters."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        number = 0
        while text := file.readline(LONGEST_LINE):
            number += 1
            rest = text
            while rest and not rest.endswith("\n"):
                rest = file.readline(LONGEST_LINE)
            too_long = len(text) == LONGEST_LINE and not text.endswith("\n")
            yield TextLine(number, text.rstrip("\n").strip("\x00"), bool(rest), too_long)


def refuse_dataset(path: Path, options: ReadOptions) -> None:
    """Refuse a choice among data sets where a file is one.

    Raises
    ------
    RecordingError
        If a data set was chosen.
    """
    if options.dataset:
        raise RecordingError(
            f"{path.name} is one data set; it has none named {options.dataset!r}", remedy="leave the name out"
        )
