"""Marlin's line protocol: numbered lines with checksums, and how a printer asks for one again."""

from dataclasses import dataclass
from functools import reduce
from operator import xor
from typing import Final

#: A longer line is cut off by the firmware's buffer.
LONGEST_LINE: Final = 96


@dataclass(frozen=True, slots=True)
class Line:
    """One line: its number, its command, and what is wrong with it in the firmware's words, if anything."""

    number: int | None
    command: str
    wrong: str = ""


def checksum(text: str) -> int:
    """XOR of the bytes before the asterisk."""
    return reduce(xor, text.encode("ascii", "replace"), 0)


def read_line(raw: bytes, last: int) -> Line:
    """Read one line as Marlin's queue does.

    Parameters
    ----------
    raw : without its end.
    last : number of the last line that was taken.
    """
    text = raw[: LONGEST_LINE - 1].decode("ascii", "replace").split(";")[0].strip()
    body, star, given = text.partition("*")
    if not text.startswith("N"):
        return Line(None, body.strip(), "No Line Number with checksum" if star else "")
    digits, _, command = body[1:].partition(" ")
    if not digits.lstrip("-").isdigit():
        return Line(None, command, "Line Number is not Last Line Number+1")
    number = int(digits)
    if not star:
        return Line(number, command, "No Checksum with line number")
    if not given.isdigit() or int(given) != checksum(body):
        return Line(number, command, "checksum mismatch")
    if number != last + 1 and "M110" not in command:
        return Line(number, command, "Line Number is not Last Line Number+1")
    return Line(number, command.strip())


def words(command: str) -> tuple[str, dict[str, float | None]]:
    """Split a command into its code and its parameters; None for those that carry no number."""
    code, *rest = command.split() or [""]
    parameters: dict[str, float | None] = {}
    for word in rest:
        try:
            parameters[word[0].upper()] = float(word[1:])
        except ValueError:
            parameters[word[0].upper()] = None
    return code.upper(), parameters
