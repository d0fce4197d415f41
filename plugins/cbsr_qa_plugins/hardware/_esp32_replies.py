"""What the multiplexer's command firmware says, found among echoes and log lines that are glued to it."""

import re
from typing import Final

from cbsr_qa.domain.patterns import Pair

#: (source, sink) and the two voltage pins. Which of these is the positive one is a matter of how the meter is wired.
Position = tuple[Pair, Pair]

_ELECTRODES: Final = re.compile(rb"isrc(\d+),isnk(\d+),vn(\d+),vp(\d+)")
_COLOUR: Final = re.compile(rb"\x1b\[[0-9;]*m")
_LOG_LINE: Final = re.compile(rb"[EWIDV] \(\d+\) ")


def last_position(said: bytes) -> Position | None:
    """Find the last answer to ``g``; the firmware's labels of source and sink are swapped."""
    found = _ELECTRODES.findall(_COLOUR.sub(b"", said))
    if not found:
        return None
    sink, source, negative, positive = map(int, found[-1])
    return (source, sink), (negative, positive)


def counter_in(said: bytes) -> int | None:
    """Find the answer to ``c``: digits between the echo and the log line that is glued to them."""
    found = re.search(rb"c(\d+)(?=[^\d])", said)
    return None if found is None else int(found[1])


def is_log(said: bytes) -> bool:
    """Whether a log line without colours has begun."""
    return _LOG_LINE.search(said) is not None
