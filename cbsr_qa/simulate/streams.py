"""Random numbers by address: (seed, name of what uses them, index), never by the order of drawing.

A counter-based generator (Philox 4×64; Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") makes
each address an independent sequence that can be reached at once. So turning an effect on changes no other
effect's numbers, and neither the number of cores nor a restart changes any.
"""

import hashlib
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError

#: Keeps these keys apart from any other use of the same hash.
_PURPOSE: Final = b"cbsr-qa stream"
_INDICES: Final = 1 << 64


class RandomStream:
    """The numbers of one user of random numbers within one seed.

    Parameters
    ----------
    seed : of the run.
    name : of what uses the numbers, e.g. an effect's registered name.
    """

    def __init__(self, seed: int, name: str) -> None:
        digest = hashlib.blake2b(f"{seed}\0{name}".encode(), digest_size=16, person=_PURPOSE).digest()
        self._key = np.frombuffer(digest, dtype="<u8").astype(np.uint64)
        self._bits = np.random.Philox(key=self._key)
        self._generator = np.random.Generator(self._bits)
        # Putting the one generator elsewhere costs a fifth of making a new one.
        self._state = self._bits.state

    def generator(self, index: int) -> np.random.Generator:
        """Return a generator of its own that starts at an index.

        Raises
        ------
        RefusedError
            If the index is not in [0, 2⁶⁴).
        """
        return np.random.Generator(np.random.Philox(key=self._key, counter=_counter(index)))

    def normal(self, index: int, shape: tuple[int, ...] = ()) -> NDArray[np.float64]:
        """Draw the standard normal numbers of an index: equal to ``generator(index).standard_normal(shape)``.

        Raises
        ------
        RefusedError
            If the index is not in [0, 2⁶⁴).
        """
        self._state["state"]["counter"] = _counter(index)
        self._bits.state = self._state
        return np.asarray(self._generator.standard_normal(shape))


def _counter(index: int) -> NDArray[np.uint64]:
    """Counter of an index: its last word, so that each index has 2¹⁹² blocks before the next one's begin."""
    if not 0 <= index < _INDICES:
        raise RefusedError(f"random numbers are addressed by whole numbers from 0 to 2^64 - 1, not by {index}")
    return np.array([0, 0, 0, index], dtype=np.uint64)
