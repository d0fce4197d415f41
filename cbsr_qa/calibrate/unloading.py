"""Where the relaxation after a release begins: behind the conductance's spike."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import finite_numbers

#: A deviation counts if it is this many noise standard deviations, or this share of the largest, from the end level.
_CLEAR: Final = 4.0
_SHARE: Final = 0.05


def relaxation_start(values: NDArray[np.float64]) -> int:
    """Return the index of the first sample behind the unloading spike's rising edge and peak.

    On unloading the conductance first spikes the other way, then relaxes to its end level. The spike's peak is the
    largest deviation from the end level (median of the last quarter) in the first half of the trace, after the
    last time the trace passed through that level; the peak itself is left out, as in the paper (3.1.2). A trace
    that is largest at its first sample has no spike and starts at 0.

    Parameters
    ----------
    values : (n,) float64, from the end of the release on.

    Returns
    -------
    int in [0, n).

    Raises
    ------
    NumericsError
        If a value is not finite.
    """
    values = finite_numbers(values, "values behind a release")
    count = len(values)
    if count < 4:
        return 0
    away = values - np.median(values[-(count // 4) :])
    early = away[: (count + 1) // 2]
    # Differences of neighbours see the noise and hardly the relaxation; their median is not moved by the spike.
    noise = 1.4826 * float(np.median(np.abs(np.diff(away[count // 2 :])))) / np.sqrt(2)
    clear = np.abs(early) > max(_CLEAR * noise, _SHARE * float(np.abs(early).max()))
    if not clear.any():
        return 0
    signs = np.where(clear, np.sign(early), 0)
    last = signs[np.flatnonzero(clear)[-1]]
    opposite = np.flatnonzero(signs == -last)
    begin = int(opposite[-1]) + 1 if opposite.size else 0
    peak = begin + int(np.argmax(np.abs(early[begin:])))
    return 0 if peak == 0 else peak + 1
