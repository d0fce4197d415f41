"""Samples of one quantity as they come, kept for an hour."""

import threading
from array import array
from bisect import bisect_right
from typing import Final

import numpy as np
from numpy.typing import NDArray

#: Whoever wants samples comes every few seconds; an hour holds any pause between two steps [s].
KEPT_S: Final = 3600.0


class SampleLog:
    """Times and values, written by one thread and read by others. Times must rise."""

    def __init__(self) -> None:
        self._times, self._values = array("d"), array("d")
        self._keeping = threading.Lock()

    @property
    def last_s(self) -> float:
        """Time of the last sample; -inf before the first [s]."""
        with self._keeping:
            return self._times[-1] if self._times else -np.inf

    def append(self, time_s: float, value: float) -> None:
        """Keep a sample, and forget those of more than an hour ago now and then."""
        with self._keeping:
            self._times.append(time_s)
            self._values.append(value)
            old = bisect_right(self._times, time_s - KEPT_S)
            if old > len(self._times) // 2:
                del self._times[:old], self._values[:old]

    def since(self, time_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times [s] and values, both (n,), after a time."""
        with self._keeping:
            first = bisect_right(self._times, time_s)
            return np.array(self._times[first:]), np.array(self._values[first:])

    def newest(self, count: int) -> NDArray[np.float64]:
        """Return the last values, at most so many, (n,)."""
        with self._keeping:
            return np.array(self._values[-count:])
