"""Random numbers addressed by (seed, stream name, index), independent of the order of drawing.

A counter-based generator (Philox 4×64; Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") makes
each address an independent sequence that can be reached at once. So turning an effect on changes no other
effect's numbers, and neither the number of cores nor a restart changes any.

Addresses of a simulated bench's random numbers depend on what is measured, never on when.

A step repeated after an interruption gives the same numbers as at first, independent of its history.
"""

import hashlib
import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.system.clock import Clock

#: Prefix that separates these keys from any other use of the same hash.
_PURPOSE: Final = b"cbsr-qa stream"
_INDICES: Final = 1 << 64


class RandomStream:
    """Random numbers of one consumer within one seed.

    ``name``: of what uses the numbers, e.g. an effect's registered name.
    """

    def __init__(self, seed: int, name: str) -> None:
        digest = hashlib.blake2b(f"{seed}\0{name}".encode(), digest_size=16, person=_PURPOSE).digest()
        self._key = np.frombuffer(digest, dtype="<u8").astype(np.uint64)
        self._bits = np.random.Philox(key=self._key)
        self._generator = np.random.Generator(self._bits)
        # Repositioning the one generator costs a fifth of creating one.
        self._state = self._bits.state

    def generator(self, index: int) -> np.random.Generator:
        """Return a new generator that starts at an index. RefusedError if the index is not in [0, 2⁶⁴)."""
        return np.random.Generator(np.random.Philox(key=self._key, counter=_counter(index)))

    def normal(self, index: int, shape: tuple[int, ...] = ()) -> Array:
        """Draw the standard normal numbers of an index: equal to ``generator(index).standard_normal(shape)``.

        RefusedError if the index is not in [0, 2⁶⁴).
        """
        self._state["state"]["counter"] = _counter(index)
        self._bits.state = self._state
        return np.asarray(self._generator.standard_normal(shape))


def _counter(index: int) -> NDArray[np.uint64]:
    """Counter of an index: its last word, so that each index has 2¹⁹² blocks before the next one's begin."""
    if not 0 <= index < _INDICES:
        raise RefusedError(f"random stream index is {index}; it must be a whole number from 0 to 2^64 - 1")
    return np.array([0, 0, 0, index], dtype=np.uint64)


# A phase, a step, an act of the head, a count: 11, 17, 12 and 24 bits. The runner allows 100 000 steps per phase;
# 2^24 samples at 8 per second are 24 days. An overflowing count continues in the next field.
_COUNTS: Final = 1 << 24
_ACTS: Final = 1 << 12
_STEPS: Final = 1 << 17


def step_act(phase: int, number: int) -> int:
    """Return the first act of a step; each act has 2²⁴ addresses, see :func:`first_address`."""
    return (phase * _STEPS + number) * _ACTS


def first_address(act: int) -> int:
    """Return the first address of an act: one of the head within a step."""
    return act * _COUNTS


class StepAddresses:
    """Counts frames and force samples within the current step and act of the head.

    Samples come at a fixed rate, counted from the beginning of their step or from the last order to the head in it,
    and so have the same times relative to a press. ``rate_hz``: of the samples; a power of two, so that their times
    are exact.
    """

    def __init__(self, clock: Clock, rate_hz: int) -> None:
        self._clock = clock
        self._rate_hz = rate_hz
        self._act = 0
        self._frames = 0
        self._since_s: list[float] = [clock.now()]
        self._first: list[int] = [0]

    def begin_step(self, phase: int, number: int) -> int:
        return self._begin(step_act(phase, number))

    def begin_act(self) -> int:
        """Begin an act of the head; return its first address."""
        return self._begin(self._act + 1)

    def frame(self) -> int:
        self._frames += 1
        return self._act * _COUNTS + self._frames

    def samples(self, after_s: float, to_s: float) -> Iterator[tuple[float, int]]:
        """Yield (time, address) of every sample after a time and up to another, in order."""
        for segment in range(max(bisect_right(self._since_s, after_s) - 1, 0), bisect_left(self._since_s, to_s)):
            since_s = self._since_s[segment]
            ends_s = self._since_s[segment + 1] if segment + 1 < len(self._since_s) else to_s
            first = max(math.floor((after_s - since_s) * self._rate_hz), 0) + 1
            last = math.floor((min(ends_s, to_s) - since_s) * self._rate_hz)
            for count in range(first, last + 1):
                yield since_s + count / self._rate_hz, self._first[segment] + count

    def _begin(self, act: int) -> int:
        self._act, self._frames = act, 0
        now_s = self._clock.now()
        if now_s == self._since_s[-1]:  # nothing was sampled since
            self._first[-1] = first_address(act)
        else:
            self._since_s.append(now_s)
            self._first.append(first_address(act))
        return first_address(act)
