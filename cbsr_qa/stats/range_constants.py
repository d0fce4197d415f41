"""Mean and deviation of the range of n normal values, by quadrature instead of printed tables.

    d₂ = ∫ [1 − Φⁿ − (1 − Φ)ⁿ] dx,   d₃² = E R² − d₂²,
    E R² = 2 ∫∫_{x<y} [1 − Φ(y)ⁿ − (1 − Φ(x))ⁿ + (Φ(y) − Φ(x))ⁿ] dx dy

Source: Tippett 1925; d₂* = √(d₂² + d₃²/g) of g ranges is Duncan's 1955 (AIAG MSA 4th edition, appendix C).
"""

from functools import lru_cache
from math import sqrt

import numpy as np
from scipy import special

from cbsr_qa.domain.errors import NumericsError

_FAR = 9.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(200)
MOST = 1000  #: values of which a range is taken; more have no range chart


@lru_cache(maxsize=64)
def d2_d3(count: int) -> tuple[float, float]:
    """Return mean and standard deviation of the range of ``count`` standard normal values.

    Raises
    ------
    NumericsError
        Fewer than two values have no range; more than 1000 are not worked out.
    """
    if not 2 <= count <= MOST:
        raise NumericsError(f"range: {count} values; allowed are 2 to {MOST}")
    y, weights = _FAR * _NODES, _FAR * _WEIGHTS
    below, above = special.ndtr(y), special.ndtr(-y)
    mean = float(np.sum(weights * (1 - below**count - above**count)))
    # For each y the inner variable runs from −9 to y.
    x = -_FAR + (y[:, None] + _FAR) * (_NODES + 1) / 2
    inner = (y[:, None] + _FAR) / 2 * _WEIGHTS
    between = special.ndtr(y)[:, None] - special.ndtr(x)
    dense = 1 - (below**count)[:, None] - special.ndtr(-x) ** count + between**count
    square = 2 * float(np.sum(weights[:, None] * inner * dense))
    return mean, sqrt(square - mean**2)


def d2_star(count: int, ranges: int) -> float:
    """Return d₂* of a mean of so many ranges, which makes (R̄/d₂*)² unbiased for the variance."""
    mean, deviation = d2_d3(count)
    return sqrt(mean**2 + deviation**2 / ranges)
