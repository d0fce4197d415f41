"""Timing of two ways to do the same thing, turn by turn, so that the machine's moods hit both."""

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Compared:
    """Fastest times of both ways [s]."""

    what: str
    ours: str
    theirs: str
    ours_s: float
    theirs_s: float

    @property
    def ratio(self) -> float:
        return self.theirs_s / self.ours_s


def compare(
    what: str,
    ours: tuple[str, Callable[[], object]],
    theirs: tuple[str, Callable[[], object]],
    repeats: int,
    burst: int = 1,
) -> Compared:
    """Time both ways in turn and keep the fastest of each.

    Parameters
    ----------
    repeats : turns.
    burst : consecutive calls of one way: more than one if it is used repeatedly, as for a stream of frames, and its
        data are so small that the other way's would push them out of the cache.
    """
    best = [float("inf"), float("inf")]
    for _ in range(repeats):
        for side, run in enumerate((ours[1], theirs[1])):
            best[side] = min(best[side], fastest(run, burst))
    return Compared(what, ours[0], theirs[0], best[0], best[1])


def fastest(run: Callable[[], object], repeats: int) -> float:
    """Fastest of some repeats [s]."""
    best = float("inf")
    for _ in range(repeats):
        before = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - before)
    return best


def shown(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.2f} {unit}"
    return f"{seconds / 1e-6:.1f} µs"


_WATCH: Final = """
import resource, subprocess, sys, time
before = time.perf_counter()
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
print(time.perf_counter() - before, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)
"""


def whole_command(command: Sequence[str]) -> tuple[float, float]:
    """Run a command to its end, and return its time [s] and the most memory that it or a child of it took [MB].

    A small separate process starts it and waits: peak memory of children is the maximum over all of them, and Linux
    includes what their parent held at the start.
    """
    watched = subprocess.run([sys.executable, "-c", _WATCH, *command], check=True, capture_output=True, text=True)
    seconds, megabytes = map(float, watched.stdout.split())
    return seconds, megabytes
