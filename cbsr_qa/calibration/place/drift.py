"""Drift of readings over a session of presses, and its later growth.

For every reading an offset and a gain proportional to time are fitted to the differences of left-out presses from
their templates. The part beyond its own standard error is treated as a random walk: after five sessions its variance
is five times that of one session. Presses in random order show no drift, and get none.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain import Array

#: Number of sessions for which a calibration is specified.
SESSIONS: Final = 5.0
#: Squared standard errors subtracted from a squared slope: one of three slopes of pure noise exceeds one.
_CLEAR: Final = 2.0
#: Shuffles of the presses that a drift must exceed.
_SHUFFLES: Final = 49
_SEED: Final = [int.from_bytes(b"drift"), 0]


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Changes (m,) of features in one session: an offset, and a share of the feature itself."""

    offset: Array
    gain: Array

    def later(self, expected: Array) -> Array:
        """One standard deviation of drift (n, m) after :data:`SESSIONS`, of expected features (n, m)."""
        change: Array = np.sqrt(SESSIONS) * (self.offset + self.gain * expected)
        return change


def find_drift(errors: Array, expected: Array, time: Array) -> Drift:
    """Fit the drift of features; none if presses in random order show as much in one case of fifty.

    Parameters
    ----------
    errors, expected : (n, m) of left-out presses: observed less expected features, and expected ones.
    time : (n,) of the presses, from −½ to ½.
    """
    if not time.any():
        return Drift(np.zeros(errors.shape[1]), np.zeros(errors.shape[1]))
    slopes, squares = _slopes(errors, expected, time)
    random = np.random.default_rng(_SEED)
    shuffled = [_slopes(errors, expected, random.permutation(time))[1].mean() for _ in range(_SHUFFLES)]
    if squares.mean() <= max(shuffled):
        slopes = np.zeros_like(slopes)
    # Shrunk by the share of a square that comes from its own error (James & Stein's positive part, one at a time).
    offset, gain = slopes * np.maximum(1 - _CLEAR / np.maximum(squares, _CLEAR), 0.0)
    return Drift(offset, gain)


def _slopes(errors: Array, expected: Array, time: Array) -> tuple[Array, Array]:
    """Least-squares slopes (2, m) of errors by time and by time × expected, and their squares in squared errors."""
    along, both = time @ errors, time @ (expected * errors)
    square, mixed, other = np.sum(time**2), time**2 @ expected, time**2 @ expected**2
    determinant = np.maximum(square * other - mixed**2, np.finfo(float).tiny)
    slopes = np.stack([other * along - mixed * both, square * both - mixed * along]) / determinant
    rest = errors - time[:, None] * (slopes[0] + slopes[1] * expected)
    variance = (rest**2).sum(axis=0) / max(len(errors) - 2, 1) / determinant
    squares: Array = slopes**2 / np.maximum(variance * [other, np.full_like(other, square)], np.finfo(float).tiny)
    return slopes, squares
