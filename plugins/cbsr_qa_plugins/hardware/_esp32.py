"""The multiplexer's command firmware: what it answers, and the order it steps in."""

import re
from typing import Final

from cbsr_qa.plugin import DrivePattern, Pair, Pairs, RefusedError

#: (source, sink) and the two voltage pins. Which of these is the positive one is a matter of how the meter is wired.
Connection = tuple[Pair, Pair]

_ELECTRODES: Final = re.compile(rb"isrc(\d+),isnk(\d+),vn(\d+),vp(\d+)")
_COLOUR: Final = re.compile(rb"\x1b\[[0-9;]*m")
_LOG_LINE: Final = re.compile(rb"[EWIDV] \(\d+\) ")


def last_position(answer: bytes) -> Connection | None:
    """Find the last answer to ``g``; the firmware's labels of source and sink are swapped."""
    positions = _ELECTRODES.findall(_COLOUR.sub(b"", answer))
    if not positions:
        return None
    sink, source, negative, positive = map(int, positions[-1])
    return (source, sink), (negative, positive)


def counter_in(answer: bytes) -> int | None:
    """Find the answer to ``c``: digits between the echo and the log line that is glued to them."""
    match = re.search(rb"c(\d+)(?=[^\d])", answer)
    return None if match is None else int(match[1])


def is_log(text: bytes) -> bool:
    """Whether a log line without colours has begun."""
    return _LOG_LINE.search(text) is not None


Order = tuple[tuple[int, int], ...]


def stepping_order(pattern: DrivePattern, *, inner: str, current_skip: int = 0, voltage_skip: int = 0) -> Order:
    """Return the order of a firmware whose pairs are k and k + 1 + skip, beginning with electrode 0.

    Returns (drive, measure) indices into the pattern, each combination once. RefusedError if the firmware's pairs are
    not the pattern's. ``inner``: ``"current"`` where the driven pair changes with every step, ``"voltage"`` where the
    measured one does.
    """
    drives = _indices("drive", pattern.drive, current_skip, pattern.electrode_count)
    measures = _indices("measure", pattern.measure, voltage_skip, pattern.electrode_count)
    if inner == "current":
        return tuple((drive, measure) for measure in measures for drive in drives)
    return tuple((drive, measure) for drive in drives for measure in measures)


def _indices(kind: str, pairs: Pairs, skip: int, count: int) -> tuple[int, ...]:
    stepped = [(k, (k + 1 + skip) % count) for k in range(count)]
    where = {pair: index for index, pair in enumerate(pairs)}
    odd = [pair for pair in stepped if pair not in where] or [pair for pair in pairs if pair not in set(stepped)]
    if odd:
        a, b = odd[0]
        whose = "not among the sensor type's" if odd[0] not in where else "of the sensor type, not among its own"
        raise RefusedError(
            f"it steps through the {kind} pairs 0-{1 + skip}, 1-{2 + skip} and so on; pair {a}-{b} is {whose}",
            remedy="the sensor type's pattern and the firmware's are to be the same",
        )
    return tuple(where[pair] for pair in stepped)
