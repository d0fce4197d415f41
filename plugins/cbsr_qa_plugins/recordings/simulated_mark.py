"""How a lab CSV says that nobody measured it: in further fields of its ``UTC:`` line.

The lab's recorders write one field there. Readers skip the line, so the mark disturbs none, and ours find it.
"""

from collections.abc import Iterable
from typing import Final

_MARK: Final = "simulated: "
#: Characters for all fields together: the titles must lie within the first 4096 bytes, by which files are recognised.
_MOST: Final = 900
_NOT_IN_A_FIELD: Final = str.maketrans({",": ";", '"': "'", "\n": " ", "\r": " "})


def mark(simulated: Iterable[str]) -> str:
    """Further fields of a ``UTC:`` line, each with the comma before it; empty where nothing was simulated."""
    fields = "".join(f",{_MARK}{what.translate(_NOT_IN_A_FIELD)}" for what in simulated)
    return fields if len(fields) <= _MOST else fields[:_MOST] + " …"


def marked(lines: Iterable[str]) -> tuple[str, ...]:
    """What ``UTC:`` lines say was simulated, each thing once; empty for a real rig's."""
    fields = (field.strip() for line in lines for field in line.split(","))
    return tuple(dict.fromkeys(field.removeprefix(_MARK) for field in fields if field.startswith(_MARK)))
