"""What a computation costs: processor time of one core, so that what else a machine does is not counted."""

import time
from collections.abc import Callable
from typing import Final, TypeVar

T = TypeVar("T")

_LEAST_S: Final = 2e-3  # shorter bursts are as long as the clock is coarse on some systems
_REPEATS: Final = 7


def timed(run: Callable[[], T]) -> tuple[T, float]:
    """Run once and return what came of it and the processor time [s]; with several threads, the sum over them."""
    before = time.process_time()
    found = run()
    return found, time.process_time() - before


def fastest_s(run: Callable[[], object], repeats: int = _REPEATS) -> float:
    """Processor time of one call [s]: the fastest of some bursts, each of as many calls as fill two milliseconds."""
    calls = _calls(run)
    return min(_burst_s(run, calls) for _ in range(repeats)) / calls


def _calls(run: Callable[[], object]) -> int:
    """How many calls a burst needs; the first ones also fill caches."""
    calls = 1
    while _burst_s(run, calls) < _LEAST_S:
        calls *= 2
    return calls


def _burst_s(run: Callable[[], object], calls: int) -> float:
    before = time.process_time()
    for _ in range(calls):
        run()
    return time.process_time() - before
